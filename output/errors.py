"""Errors by blame, as output/ raises them; every message names the value, the bound and the next step."""


class OutputError(Exception):
    """Base of the errors that output/ raises on purpose."""


class BadCommand(OutputError):
    """A command or a command file that no board would take: a value out of range, a syntax error, a missing feature."""


class BoardRefused(OutputError):
    """The board answered with an error, or is not what it should be."""


class PositionLost(BoardRefused):
    """The machine is not where the board counts it: `why`, and, where that wants mending first, `mend`.

    `plotter home` would go by the counters, and be wrong by as much.
    """

    def __init__(self, why: str, mend: str = "") -> None:
        first = f"{mend}, then " if mend else ""
        super().__init__(f"{why}: {first}run `plotter align` and push the carriage to its home corner")


class LinkLost(OutputError):
    """The port went away or the board stopped answering."""
