"""Measured speed and quality, one command: `make bench`."""
