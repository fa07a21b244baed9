"""`plotter export`: the board's commands as a file that can be looked at, verified and sent by itself."""

from __future__ import annotations

import sys
from typing import Any

import click

from output.ebb.command_file import write_command_file
from output.ebb.verify import verify
from output.wording import counted
from plotter.board_setup import board_setup
from plotter.cli.help import HeadedCommand
from plotter.cli.options import collect, settings_options
from plotter.cli.outputs import spare
from plotter.cli.reading import collect_reading, reading_options
from plotter.cli.say import notes
from plotter.cli.standard_streams import done
from plotter.errors import BadInput
from plotter.estimate import PlanTally
from plotter.pipeline import planned, prepare, program
from plotter.settings import ResolvedSettings
from plotter.units import spoken_duration


@click.command(cls=HeadedCommand)
@click.argument("file", metavar="FILE.svg")
@click.option("-o", "--output", required=True, metavar="OUT.ebb", help="Command file to write; - writes standard output.")
@settings_options
@reading_options
def export(file: str, output: str, **options: Any) -> None:
    """Write the commands that would plot FILE.svg (- reads standard input) to a file.

    \b
    plotter export drawing.svg -o drawing.ebb
    plotter export drawing.svg -o drawing.ebb --firmware 2.8.1
    """
    spare({"drawing": file, "settings file": options.get("settings_file")}, output)
    resolved = collect(options)
    job = prepare(file, collect_reading(options), resolved.values)
    notes(job.notes)
    tally = PlanTally()
    setup = board_setup(job.settings, job.machine)
    items = list(program(tally.watch(planned(job)), setup))
    report = verify(items, setup.firmware, setup.kinematics, setup.origin_mm, keep_strokes=False)
    header = {
        "machine": job.machine.name,
        "firmware": job.settings.firmware,
        "drawing": f"{job.name} sha256 {job.digest}",
        "page_mm": f"{job.drawing.width_mm:.12g} {job.drawing.height_mm:.12g}",
        "placement": job.arranged.placement.written(),
        "settings": _in_force(resolved),
        "duration_s": f"{report.duration_s:.2f}",
        "lowest_lead_s": "-" if report.lowest_lead_s is None else f"{report.lowest_lead_s:.2f}",
        "strokes": tally.total.strokes,
        "commands": report.commands,
    }
    if output == "-":
        write_command_file(sys.stdout, header, items)
        return
    try:
        write_command_file(output, header, items)
    except OSError as error:
        raise BadInput(f"cannot write {output}: {error.strerror}; give another file with -o") from None
    done(f"{output}: {counted(report.commands, 'command')}, {spoken_duration(report.duration_s)}")


def _in_force(resolved: ResolvedSettings) -> str:
    """Every setting that is not the program's own default, as `key=value` words."""
    values = resolved.values.model_dump()
    return " ".join(f"{key}={value}" for key, value in values.items() if resolved.origin[key] != "default")
