"""The virtual EiBotBoard: written from the protocol reference, never from the encoder, so that the two can disagree."""

from output.ebb.virtual.process import VirtualBoard, start_virtual_board

__all__ = ["VirtualBoard", "start_virtual_board"]
