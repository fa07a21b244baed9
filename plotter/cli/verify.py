"""`plotter verify`: what a board would draw from a command file, and whether it should be sent."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import click
import numpy as np

from output.ebb.command_file import read_command_file
from output.ebb.firmware import firmware
from output.ebb.verify import Report, verify
from output.ebb.verify_compare import Comparison, compare
from output.wording import counted
from plotter.arrange import Placement
from plotter.cli.help import HeadedCommand
from plotter.cli.outputs import spare
from plotter.cli.reading import collect_reading, read_file, reading_options
from plotter.errors import BadInput
from plotter.machines.profile import Machine, load_machine, load_quality
from plotter.settings import Settings
from plotter.svg.options import ReadOptions
from plotter.units import length_mm, spoken_duration

DEFAULT_MACHINE, DEFAULT_FIRMWARE = "axidraw-v3", "3.0.3"


def _distance(ctx: click.Context, param: click.Parameter, value: str | None) -> float | None:
    try:
        distance_mm = None if value is None else length_mm(value)
    except ValueError as error:
        raise click.BadParameter(str(error), ctx, param) from None
    if distance_mm is not None and distance_mm <= 0:
        raise click.BadParameter(f"{value} is not more than 0; give a length like 0.05mm", ctx, param)
    return distance_mm


@click.command("verify", cls=HeadedCommand)
@click.argument("file", metavar="COMMANDS")
@click.option(
    "--machine", "machine_name", metavar="MACHINE", help="Machine, when the file's head names none or another is meant."
)
@click.option(
    "--firmware", "version", metavar="FIRMWARE", help="Firmware, when the file's head names none or another is meant."
)
@click.option(
    "--strokes", "strokes_file", type=click.Path(path_type=Path, dir_okay=False), help="Write pen-down polylines (JSON)."
)
@click.option(
    "--against", metavar="FILE.svg", help="Also compare what would be drawn with this drawing, both ways: it must be the same."
)
@click.option(
    "--within",
    "within_mm",
    callback=_distance,
    metavar="LENGTH",
    help="How far ink and drawing may be from each other. Default: the tolerance in the file's head and the motor steps that "
    "its commands need, 1.4 (T3), 2.5 (LT, LM) or 4 (SM, XM); for ink where there is no line, half of the join length more.",
)
@click.option("--json", "as_json", is_flag=True, help="For programs.")
@reading_options
def verify_file(
    file: str,
    machine_name: str | None,
    version: str | None,
    strokes_file: Path | None,
    against: str | None,
    within_mm: float | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Replay COMMANDS (- reads standard input) with the firmware's exact arithmetic. Exit code 2 when they should not be sent.

    \b
    plotter verify drawing.ebb
    plotter verify drawing.ebb --against drawing.svg
    plotter verify drawing.ebb --json --strokes ink.json
    """
    if within_mm is not None and against is None:
        raise BadInput("--within says how far from a drawing: give the drawing with --against")
    spare({"command file": file, "drawing": against}, strokes_file)
    faults: list[str] = []
    try:
        header, lines = read_command_file(_standard_input() if file == "-" else file, faults)
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"cannot read {file}: {getattr(error, 'strerror', None) or error}; give a command file") from None
    file = "standard input" if file == "-" else file
    machine = load_machine(machine_name or header.get("machine", DEFAULT_MACHINE))
    version = version or header.get("firmware")
    board = firmware(version or DEFAULT_FIRMWARE)
    reach = (0.0, 0.0, machine.width_mm, machine.height_mm)
    report = verify(lines, board, machine.kinematics(), travel_mm=reach, problems=faults)
    report.problems += head_faults(header, report)
    if not report.commands:
        raise BadInput(f"{file} holds no board commands" + (f": {faults[0]}" if faults else "; give a file that export wrote"))
    if version is None:
        report.warnings.append(f"the file names no firmware: {DEFAULT_FIRMWARE} is taken; give --firmware for another")
    if strokes_file is not None:
        _write_strokes(strokes_file, report, header, machine)
    compared: dict[str, Any] = {}
    if against is not None:
        comparison = _compared(report, against, _placement(header), collect_reading(options))
        allowed = _Allowed(within_mm, within_mm) if within_mm else _allowed(header, report, machine, comparison)
        report.problems += _beyond(comparison, against, allowed)
        compared = {"against": {"drawing": against, **comparison.as_dict(), "allowed": allowed._asdict()}}
    if as_json:
        click.echo(json.dumps(_rounded({"file": file, "machine": machine.name, **report.as_dict(), **compared}), indent=2))
    else:
        click.echo(_said(file, report))
        if against is not None:
            click.echo(_comparison_said(against, comparison, allowed))
    if not report.sendable:
        raise BadInput(f"{file} should not be sent: {report.problems[0]}" + _more(report.problems))


def _standard_input() -> TextIO:
    """As a file is read: what is no text is told where its line comes."""
    if isinstance(sys.stdin, io.TextIOWrapper):
        sys.stdin.reconfigure(encoding="utf-8", errors="surrogateescape")
    return sys.stdin


def head_faults(header: dict[str, str], report: Report) -> list[str]:
    """What the head of a command file says of it and is not so: it was cut short, or changed by hand."""
    said = header.get("commands", "")
    if said.isdigit() and int(said) != report.commands:
        wrong = f"its head says {counted(int(said), 'command')}, it holds {report.commands}"
        return [f"{wrong}: it was cut short or changed; export it again, or correct its head"]
    return []


def _compared(report: Report, drawing: str, placement: Placement, reading: ReadOptions) -> Comparison:
    """Ink against the drawing, both on the machine."""
    wanted = [stroke.points_mm for layer in read_file(drawing, reading).layers for stroke in layer.strokes]
    if not report.strokes or not wanted:
        raise BadInput("there is nothing to compare: the command file or the drawing has no strokes; leave out --against")
    return compare(report.strokes, [placement.apply(points) for points in wanted])


class _Allowed(NamedTuple):
    """How far (mm) ink may lie off the drawing, and the drawing off the ink."""

    drawn_mm: float
    wanted_mm: float


def _allowed(header: dict[str, str], report: Report, machine: Machine, comparison: Comparison) -> _Allowed:
    """How far an export of ours may be from its drawing, by what its head says and what its commands can do.

    The plan keeps to the tolerance, and leaves out lines that lie on others. The encoder may be off the plan by what its sizing
    says, and both motors by a step for rounding; positions are compared between samples. There is more ink in the straight
    links that join strokes, of which no point is further from an end than half the link.
    """
    from output.ebb.encode_families import Sizing
    from planning.ordering.crowds import SAME_LINE_MM

    sizing = Sizing()
    off = {"jerk": sizing.merge_steps, "acceleration": sizing.lt_steps * sizing.worst_steps}
    steps = 1.0 + off.get(report.constant, sizing.sm_steps * sizing.worst_steps)
    to_mm = np.linalg.inv(machine.kinematics().steps_per_mm)
    step_mm = max(float(np.hypot(*(to_mm @ signs))) for signs in ((1.0, 1.0), (1.0, -1.0)))
    plan_mm = _in_head(header, "tolerance", load_quality("normal").tolerance_mm) + SAME_LINE_MM
    wanted_mm = plan_mm + steps * step_mm + comparison.sample_mm / 2
    return _Allowed(wanted_mm + _in_head(header, "join", float(Settings.model_fields["join"].default)) / 2, wanted_mm)


def _in_head(header: dict[str, str], key: str, otherwise: float) -> float:
    """A setting in millimetres that the file was made with; `otherwise` when its head does not say it."""
    said = dict(word.split("=", 1) for word in header.get("settings", "").split() if "=" in word).get(key)
    if said is None:
        return otherwise
    try:
        return max(0.0, float(said))
    except ValueError:
        raise BadInput(f"the command file's head is damaged: {key} is {said!r}; export the drawing again") from None


def _beyond(comparison: Comparison, drawing: str, allowed: _Allowed) -> list[str]:
    """Whether ink lies where there is no line, or a line has no ink."""
    return [
        f"{what} by {way.max_mm:.4f} mm, allowed is {most_mm:.4f} mm: export the drawing again, or allow more (--within)"
        for what, way, most_mm in (
            (f"ink lies off {drawing}", comparison.drawn, allowed.drawn_mm),
            (f"lines of {drawing} lie off the ink", comparison.wanted, allowed.wanted_mm),
        )
        if way.max_mm > most_mm
    ]


def _placement(header: dict[str, str]) -> Placement:
    """Where the file's head says that the page lies on the machine: at home, unturned, when it says nothing."""
    try:
        return Placement.parse(header.get("placement", "1 0 0 1 0 0"))
    except ValueError as error:
        raise BadInput(f"the command file's head is damaged: {error}; export the drawing again") from None


def _comparison_said(drawing: str, comparison: Comparison, allowed: _Allowed) -> str:
    lines = [f"  against {drawing}, sampled every {comparison.sample_mm:.3f} mm"]
    for name, way, most_mm in (
        ("ink off the drawing", comparison.drawn, allowed.drawn_mm),
        ("drawing off the ink", comparison.wanted, allowed.wanted_mm),
    ):
        greatest = f"greatest {way.max_mm:.4f} mm of {most_mm:.4f} mm allowed"
        lines.append(f"    {name}: mean {way.mean_mm:.4f} mm, 99 % {way.p99_mm:.4f} mm, {greatest}")
    return "\n".join(lines)


def _more(problems: list[str]) -> str:
    return f" (and {counted(len(problems) - 1, 'more problem')})" if len(problems) > 1 else ""


def _write_strokes(path: Path, report: Report, header: dict[str, str], machine: Machine) -> None:
    """Page millimetres, in the form that `plotter strokes` has, so that the two can be compared."""
    placement = _placement(header)
    polylines = [np.round(placement.back(stroke), 5).tolist() for stroke in report.strokes]
    width_mm, height_mm = (float(word) for word in header.get("page_mm", f"{machine.width_mm} {machine.height_mm}").split())
    try:
        path.write_text(json.dumps({"width_mm": width_mm, "height_mm": height_mm, "polylines": polylines}), encoding="utf-8")
    except OSError as error:
        raise BadInput(f"cannot write {path}: {error.strerror}; give another file with --strokes") from None


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    return {key: round(value, 6) if isinstance(value, float) else value for key, value in values.items()}


def _lead(report: Report) -> str:
    """The least motion that is queued while the pen moves."""
    assert report.lowest_lead_s is not None
    said = f"{report.lowest_lead_s * 1000:.0f} ms before command {report.lowest_lead_at + 1}"
    if report.queue_depth == 1:
        return f"{said} (this firmware queues one command)"
    if not report.queue_filled:
        return f"{said} (too little in it to fill the queue)"
    return said


def _slowed(report: Report) -> str:
    share = report.slowed_s / max(report.duration_s - report.slowed_s, 1e-9)
    return (
        f"{counted(report.slowed_motions, 'motion')} for that, up to {report.slowed_most:.2f} times, "
        f"{report.slowed_s:.1f} s ({share * 100:.1f} %) in all"
    )


def _highest(report: Report) -> str:
    """Speed, and what of acceleration and jerk the commands have: those of the others go from one to the next in jumps."""
    speed, acceleration = f"{report.max_speed_mm_s:.1f} mm/s", f"{report.max_acceleration_mm_s2:.0f} mm/s2"
    if report.constant == "speed":
        return f"{speed} (commands of constant speed: no acceleration, no jerk)"
    if report.constant == "acceleration":
        return f"{speed}, {acceleration} (commands of constant acceleration: no jerk)"
    return f"{speed}, {acceleration}, {report.max_jerk_mm_s3:.0f} mm/s3"


def _said(file: str, report: Report) -> str:
    lines = [
        f"{file}: {counted(report.commands, 'command')} for firmware {report.firmware}",
        f"  duration       {spoken_duration(report.duration_s)}",
        f"  pen down       {report.pen_down_mm / 1000:.3f} m in {counted(len(report.strokes), 'stroke')},"
        f" {counted(report.pen_lifts, 'lift')}",
        f"  highest        {_highest(report)}; jump of speed {report.max_velocity_jump_mm_s:.3f} mm/s",
        f"  ends at        {report.final_steps[0]}, {report.final_steps[1]} steps"
        f" ({report.final_position_mm[0]:.3f}, {report.final_position_mm[1]:.3f} mm)",
    ]
    if report.bounds_mm is not None:
        left, top, right, bottom = report.bounds_mm
        lines.append(f"  drawn area     x {left:.1f} to {right:.1f} mm, y {top:.1f} to {bottom:.1f} mm")
    if report.lowest_lead_s is not None:
        lines.append(f"  lowest lead    {_lead(report)}, {counted(report.predicted_underruns, 'predicted underrun')}")
    if report.slowed_motions:
        lines.append(f"  slowed down    {_slowed(report)}")
    lines += [f"  warning: {warning}" for warning in report.warnings]
    lines += [f"  problem: {problem}" for problem in report.problems]
    return "\n".join(lines)
