"""Errors by blame, as output/ raises them; every message names the value, the bound and the next step."""


class OutputError(Exception):
    """Base of the errors that output/ raises on purpose."""


class BadCommand(OutputError):
    """A command or a command file that no board would take: a value out of range, a syntax error, a missing feature."""


class BoardRefused(OutputError):
    """The board answered with an error, or is not what it should be."""


class LinkLost(OutputError):
    """The port went away or the board stopped answering."""
