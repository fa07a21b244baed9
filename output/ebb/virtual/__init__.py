"""The virtual EiBotBoard: written from the protocol reference, never from the encoder, so that the two can disagree."""
