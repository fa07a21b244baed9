"""`plotter plot`: a drawing onto paper, or onto the built-in virtual board's."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click
import numpy as np

from output.ebb.ports import choose_port
from output.ebb.session import connect
from output.ebb.virtual.process import VirtualBoard, start_virtual_board
from output.wording import counted
from planning.motion.limits import Kinematics
from plotter.board_setup import HOME_MM, board_setup
from plotter.cli.awake import awake
from plotter.cli.board import position_mm
from plotter.cli.help import HeadedCommand
from plotter.cli.journal import begun
from plotter.cli.options import SIM, collect, settings_options
from plotter.cli.outputs import spare
from plotter.cli.parts import plot_in_parts
from plotter.cli.ranges import NumberRange
from plotter.cli.reading import collect_reading, reading_options
from plotter.cli.say import notes
from plotter.cli.standard_streams import done, keyboard_after_a_drawing
from plotter.cli.streaming import WITHOUT_JOURNAL, Ended, finish, patience_s, told_how_to_go_on
from plotter.errors import BadInput
from plotter.journals import Part
from plotter.journals import head as journal_head
from plotter.pipeline import Job, prepare
from plotter.preview.formats import picture_format
from plotter.settings import Settings
from plotter.units import spoken_duration

# The board stands on whole steps.
_AT_WELL_MM = 0.02


@click.command(cls=HeadedCommand)
@click.argument("file", metavar="FILE.svg")
@click.option(
    "--port",
    help="Serial port or nickname of the board; `sim` is the built-in virtual board. Default: the only board there is.",
)
@click.option("--speed", type=NumberRange(0.1, 1000), default=1.0, help="How much faster than real time `sim` runs.")
@click.option("--record", type=click.Path(path_type=Path, dir_okay=False), help="Keep the virtual board's record (JSON).")
@click.option("--picture", type=click.Path(path_type=Path, dir_okay=False), help="Draw the virtual board's ink: .png or .svg.")
@settings_options
@reading_options
def plot(file: str, port: str | None, speed: float, record: Path | None, picture: Path | None, **options: Any) -> None:
    """Plot FILE.svg (- reads standard input). Ctrl-C pauses with the pen up; once more, it stops.
    Ctrl-Z pauses and suspends; `fg` comes back to the pause.

    \b
    plotter plot drawing.svg --port /dev/ttyACM0
    plotter plot drawing.svg --port sim --speed 8 --picture ink.png
    """
    if port != SIM and (record or picture or speed != 1.0):
        raise BadInput("--speed, --record and --picture are the virtual board's: give --port sim with them")
    spare({"drawing": file, "settings file": options.get("settings_file")}, record, picture)
    if picture is not None:
        picture_format(picture)
    settings = collect(options).values
    device = SIM if port == SIM else choose_port(port)
    reading = collect_reading(options)
    job = prepare(file, reading, settings, _start_mm(device, settings))
    if file == "-":
        keyboard_after_a_drawing()
    notes(job.notes)
    if port == SIM:
        with start_virtual_board(
            firmware=settings.firmware, speed=speed, record=record, keep_wire=False, patience_s=patience_s(speed)
        ) as virtual:
            _plot_on(job, virtual.port, speed, None)
            _keep_picture(virtual, picture, job)
        return
    _plot_on(job, device, 1.0, journal_head(job, file, reading))


def _start_mm(device: str, settings: Settings) -> np.ndarray:
    """Where the pen is, in machine millimetres (2,). Raises BoardRefused when the board cannot know it."""
    if settings.start == "here" and device == SIM:
        notes(["--start here: the virtual board has just been switched on, so that here is home"])
    if settings.start == "home" or device == SIM:
        return HOME_MM
    with connect(choose_port(device), clear=False, pen_pin=settings.pen_lift().other_pin) as board:
        return position_mm(board, settings)


def _plot_on(job: Job, port: str, board_speed: float, head: dict[str, Any] | None) -> None:
    """Plot on the board at `port`. `head` is the journal's; None keeps none, for a board that goes when the plot does."""
    attended = head is not None or sys.stdin.isatty()
    checksums, pen_pin = job.settings.checksums, job.settings.pen_lift().other_pin
    with awake(), connect(port, board_speed=board_speed, checksums=checksums, pen_pin=pen_pin) as board:
        setup = board_setup(job.settings, job.machine, board.firmware)
        board.watch_supply()  # before the journal of another plot is given up: a refused one has drawn nothing over it

        def not_resumed() -> str:
            """What this is, where it cannot be resumed: what was read from standard input is gone, and so is what a full disk
            did not take."""
            if head is None:
                return "a plot on the built-in virtual board"
            if head["file"] == "-":
                return "a drawing from standard input"
            return "" if journal is not None and not journal.trouble else WITHOUT_JOURNAL

        with told_how_to_go_on(lambda: not not_resumed()), begun(head) as journal:
            ended = plot_in_parts(board, job, setup, journal, _first_part(job), pauses=attended)
    where = f"{job.name} on {board.port_name}, firmware {board.firmware}"
    finish(ended, where, not_resumed=not_resumed(), board_stays=head is not None)
    done(_summary(job, ended))
    if ended.total.stalls and board_speed <= 1:
        stalls, stalled_s = ended.total.stalls, ended.total.stalled_s
        done(f"the board waited {counted(stalls, 'time')} for the computer, {stalled_s:.2f} s in all")


def _first_part(job: Job) -> Part | None:
    """The whole plot; from where the pen is, the board's counters go on."""
    if job.settings.start == "home":
        return None
    here = (float(job.start_mm[0]), float(job.start_mm[1]))
    return Part(0, 0.0, here, here, False)


def _summary(job: Job, ended: Ended) -> str:
    length_m = sum(stroke.length_mm for layer in job.layers for stroke in layer.strokes) / 1000
    return (
        f"plotted {job.name}: {counted(job.stroke_count, 'stroke')}, {length_m:.3f} m pen down in "
        f"{spoken_duration(ended.total.board_time_s)} of board time ({spoken_duration(ended.took_s)} by the clock)"
    )


def _keep_picture(virtual: VirtualBoard, picture: Path | None, job: Job) -> None:
    if picture is None:
        return
    # Pictures and their libraries are needed at the very end, if at all.
    from plotter.preview.picture import draw_ink
    from plotter.preview.table import table_of

    table = table_of(job)
    ink = [line for line in ink_mm(virtual.record(), job.machine.kinematics()) if not _is_dip(line, table.well_mm)]
    colors = [stroke.color for layer in job.layers for stroke in layer.strokes]
    draw_ink(picture, ink, table, colors=colors if len(colors) == len(ink) else None)


def _is_dip(line: np.ndarray, well_mm: np.ndarray | None) -> bool:
    """A dot in the well, which is ink for the pen and none on the paper."""
    return well_mm is not None and len(line) == 1 and bool(np.abs(line - well_mm).max() < _AT_WELL_MM)


def ink_mm(record: dict[str, Any], kinematics: Kinematics) -> list[np.ndarray]:
    """The virtual board's ink, a polyline (n, 2) in machine millimetres for each time the pen was down."""
    return [kinematics.millimetres(np.array(stroke["points"], dtype=float)) for stroke in record["ink"]]
