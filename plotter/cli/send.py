"""`plotter send`: a command file to a board, checked first."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import click

from output.ebb.command_file import Line, read_command_file
from output.ebb.commands import Command
from output.ebb.firmware import firmware
from output.ebb.ports import choose_port
from output.ebb.program import PauseMark, refused_in_a_stream
from output.ebb.session import connect
from output.ebb.verify import verify
from output.ebb.virtual.process import start_virtual_board
from output.wording import counted
from plotter.cli.awake import awake
from plotter.cli.options import SIM
from plotter.cli.ranges import NumberRange
from plotter.cli.say import notes, passed_over
from plotter.cli.standard_streams import done
from plotter.cli.streaming import finish, patience_s, streamed
from plotter.cli.verify import DEFAULT_FIRMWARE, DEFAULT_MACHINE, head_faults
from plotter.errors import BadInput
from plotter.machines.profile import load_machine
from plotter.units import spoken_duration


@click.command()
@click.argument("file", metavar="COMMANDS")
@click.option(
    "--port",
    help="Serial port or nickname of the board; `sim` is the built-in virtual board. Default: the only board there is.",
)
@click.option("--speed", type=NumberRange(0.1, 1000), default=1.0, help="How much faster than real time `sim` runs.")
def send(file: str, port: str | None, speed: float) -> None:
    """Send a command file to a board, after replaying it as `plotter verify` does.

    p pauses before the next stroke, and goes on. q stops, as does the first Ctrl-C, at a terminal or not: pen up, motors off,
    exit code 130. Nothing of it can be resumed: push the carriage to its home corner then. Ctrl-Z pauses like p, and suspends.

    \b
    plotter send drawing.ebb --port /dev/ttyACM0
    """
    where = SIM if port == SIM else choose_port(port)
    try:
        header, lines = read_command_file(file)
        items = list(lines)
    except OSError as error:
        raise BadInput(f"cannot read {file}: {error.strerror}; give a command file") from None
    version = header.get("firmware", DEFAULT_FIRMWARE)
    if where == SIM:
        with start_virtual_board(firmware=version, speed=speed, keep_wire=False, patience_s=patience_s(speed)) as virtual:
            _send_to(virtual.port, file, header, items, speed, built_in=True)
        return
    _send_to(where, file, header, items)


def _send_to(
    port: str, file: str, header: dict[str, str], items: list[Line], board_speed: float = 1.0, *, built_in: bool = False
) -> None:
    """`built_in`: the board is the virtual one, which goes with this program and has no button to end a pause with."""
    machine = load_machine(header.get("machine", DEFAULT_MACHINE))
    with awake(), connect(port, board_speed=board_speed) as board:
        reach = (0.0, 0.0, machine.width_mm, machine.height_mm)
        commands, variables = (line.item for line in items if isinstance(line.item, Command)), board.abilities.variables
        faults = [fault for command in commands if (fault := refused_in_a_stream(command, variables))]
        report = verify(
            items, firmware(board.firmware), machine.kinematics(), travel_mm=reach, keep_strokes=False, problems=faults
        )
        report.problems += head_faults(header, report)
        if not report.sendable:
            raise BadInput(
                f"{file} was not sent to firmware {board.firmware}: {report.problems[0]}; see `plotter verify {file}`"
            )
        if built_in and not sys.stdin.isatty():
            items = list(_without_pauses(items))
        ended = streamed(board, (line.item for line in items), [report.duration_s])
    finish(ended, f"{file} on {board.port_name}", not_resumed="a command file", board_stays=not built_in)
    done(f"sent {file}: {counted(report.commands, 'command')}, {spoken_duration(report.duration_s)} of board time")


def _without_pauses(items: list[Line]) -> Iterator[Line]:
    """A virtual board with nobody at a keyboard: a pause would never end, so it is said, once for each, and passed over."""
    notes(passed_over(line.item.message) for line in items if isinstance(line.item, PauseMark))
    return (line for line in items if not isinstance(line.item, PauseMark))
