"""EiBotBoard: every firmware generation from 1.x to 3.x."""
