"""`plotter`: the commands, and how every failure becomes one sentence and an exit code by its cause."""

from __future__ import annotations

import os
import sys
import traceback
from contextlib import suppress
from typing import ClassVar

import click

from output.ebb.control import signals_as_they_were
from output.errand import still_busy
from output.errors import BadCommand, BoardRefused, LinkLost
from planning.errors import PlanningError
from plotter.cli import standard_streams
from plotter.cli.start import loaded
from plotter.errors import BadInput, Interrupted, Paused

DONE, INTERNAL, BAD_INPUT, REFUSED, LINK_LOST, PAUSED, INTERRUPTED = 0, 1, 2, 3, 4, 5, 130

EXIT_CODES: tuple[tuple[type[BaseException], int], ...] = (
    (BadInput, BAD_INPUT),
    (PlanningError, BAD_INPUT),
    (BadCommand, BAD_INPUT),
    (BoardRefused, REFUSED),
    (LinkLost, LINK_LOST),
    (Paused, PAUSED),
    (Interrupted, INTERRUPTED),
    (KeyboardInterrupt, INTERRUPTED),
)


class LazyGroup(click.Group):
    """Commands are imported when they are asked for, so that `plotter pen up` does not wait for the planner's libraries."""

    homes: ClassVar[dict[str, str]] = {
        "plot": "plotter.cli.plot:plot",
        "preview": "plotter.cli.preview:preview",
        "export": "plotter.cli.export:export",
        "verify": "plotter.cli.verify:verify_file",
        "send": "plotter.cli.send:send",
        "resume": "plotter.cli.resume:resume",
        "layers": "plotter.cli.reading:layers",
        "strokes": "plotter.cli.reading:strokes",
        **{name: f"plotter.cli.board:{name}" for name in ("ports", "board", "pen", "move", "home", "align", "disable")},
        "machines": "plotter.cli.settings:machines",
        "settings": "plotter.cli.settings:show_settings",
        "virtual": "plotter.cli.virtual:virtual",
    }

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click's signature
        return list(self.homes)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002 - click's signature
        if cmd_name not in self.homes:
            return None
        module, name = self.homes[cmd_name].split(":")
        command = getattr(__import__(module, fromlist=[name]), name)
        loaded()
        if not isinstance(command, click.Command):
            raise TypeError(f"{self.homes[cmd_name]} is not a command")
        return command


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="plotter")
def cli() -> None:
    """Plot SVG files on EiBotBoard pen plotters: smoothly, exactly, and with the pen always lifted at the end.

    \b
    plotter plot drawing.svg                     plot it on the board that is connected
    plotter plot drawing.svg --port sim          plot it on the built-in virtual board
    plotter preview drawing.svg -o picture.png   how long it takes, and a picture
    plotter export drawing.svg -o drawing.ebb    write the board's commands to a file
    """


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit: 0 done, 1 internal, 2 bad input, 3 refused, 4 link lost, 5 paused, 130 interrupted."""
    # Matrices are small here: more threads for them would only wait for work, on the cores that others need.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    standard_streams.open_the_closed()
    code = _run(arguments)
    standard_streams.in_time(standard_streams.settle)
    if still_busy():
        # A plot, or a reading, that was ended early: everything is said and closed, and taking the interpreter down around a
        # thread that is in the middle of a computation makes extension modules complain on the terminal. Or a terminal takes
        # nothing, which would be waited for.
        os._exit(code)
    sys.exit(code)


def run(arguments: list[str] | None = None) -> int:
    """Run the command line and return its exit code; failures are said on stderr in one sentence.

    For whoever goes on afterwards: the signals that a plot ignores in its last moments are as they were.
    """
    with signals_as_they_were():
        return _run(arguments)


def _run(arguments: list[str] | None) -> int:
    try:
        result = cli.main(args=arguments, prog_name="plotter", standalone_mode=False)
        sys.stdout.flush()  # here, where it can be told that it fails
        return result if isinstance(result, int) else DONE
    except click.exceptions.Abort as error:  # Ctrl-C while nothing is sent: what plots ends by itself, and says how
        asked = isinstance(error.__cause__ or error.__context__, EOFError)
        _say("the question was not answered, and nothing was done" if asked else "interrupted")
        return INTERRUPTED
    except SystemExit:  # click's answer to a pipe that nobody reads any more
        return DONE
    except click.ClickException as error:
        _say(error.format_message() + _usage_hint(error))
        return BAD_INPUT
    except tuple(kind for kind, _ in EXIT_CODES) as error:
        for reason in error.reasons if isinstance(error, BadInput) else ():
            standard_streams.aside(f"note: {reason}")
        _say(str(error) or "interrupted")
        return next(code for kind, code in EXIT_CODES if isinstance(error, kind))
    except OSError as error:
        if error.errno in standard_streams.NOBODY_READS:
            return DONE
        if error.errno in standard_streams.NO_ROOM:
            _say(f"the output cannot be written ({error.strerror}): make room there, or send it elsewhere")
            return BAD_INPUT
        return _internal()
    except Exception:
        return _internal()


def _internal() -> int:
    """For an exception that nobody foresaw."""
    _say("something went wrong inside the program; please report what follows")
    with suppress(OSError):
        traceback.print_exc()
    return INTERNAL


def _say(message: str) -> None:
    standard_streams.aside(f"plotter: {message}")


def _usage_hint(error: click.ClickException) -> str:
    if isinstance(error, click.UsageError) and error.ctx is not None:
        return f" (see `{error.ctx.command_path} --help`)"
    return ""
