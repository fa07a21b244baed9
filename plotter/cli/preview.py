"""`plotter preview`: how long a drawing takes, of what, and a picture of where the pen goes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from output.ebb.estimate import estimate
from output.wording import counted
from planning.motion.plan import Action
from plotter.board_setup import board_setup
from plotter.cli.help import HeadedCommand
from plotter.cli.options import collect, settings_options
from plotter.cli.outputs import spare
from plotter.cli.reading import collect_reading, reading_options
from plotter.cli.say import notes
from plotter.estimate import PlanTally, facts
from plotter.pipeline import Job, planned, prepare, program
from plotter.preview.formats import picture_format
from plotter.preview.picture import draw_picture
from plotter.preview.table import table_of
from plotter.units import spoken_duration

# So many places of the same pause are listed.
_MOST_PAUSES = 8
# The share of the time from which on it is said that motion was slowed down.
_WORTH_SAYING = 0.02


@click.command(cls=HeadedCommand)
@click.argument("file", metavar="FILE.svg")
@click.option("-o", "--output", type=click.Path(path_type=Path, dir_okay=False), help="Picture to draw: .png or .svg.")
@click.option("--json", "as_json", is_flag=True, help="For programs.")
@settings_options
@reading_options
def preview(file: str, output: Path | None, as_json: bool, **options: Any) -> None:
    """Estimate how long FILE.svg takes (- reads standard input), and draw where the pen goes.

    \b
    plotter preview drawing.svg
    plotter preview drawing.svg -o picture.png
    plotter preview drawing.svg --quality draft --json
    """
    spare({"drawing": file, "settings file": options.get("settings_file")}, output)
    if output is not None:
        picture_format(output)
    settings = collect(options).values
    job = prepare(file, collect_reading(options), settings)
    notes(job.notes)
    tally = PlanTally()
    actions = tally.watch(planned(job))
    if output is not None:
        kept = list(actions)
        _draw(job, kept, output)
        actions = iter(kept)
    setup = board_setup(job.settings, job.machine)
    values = {"file": job.name, "machine": job.machine.name, **facts(tally, estimate(program(actions, setup), setup.firmware))}
    click.echo(json.dumps(values, indent=2) if as_json else _report(values, job, output))


def _draw(job: Job, actions: list[Action], output: Path) -> None:
    draw_picture(
        output,
        actions,
        table_of(job),
        layer_colors={layer.number: layer.color for layer in job.layers},
        stroke_colors=[stroke.color for layer in job.layers for stroke in layer.strokes],
    )


def _report(values: dict[str, Any], job: Job, output: Path | None) -> str:
    left, top, right, bottom = values["bounds_mm"]
    strokes, lifts = counted(values["strokes"], "stroke"), values["pen_lifts"]
    lines = [
        f"{job.name} on {job.machine.title}",
        f"  total      {spoken_duration(values['duration_s']):>12}",
        f"  pen down   {spoken_duration(values['pen_down_s']):>12}   {values['pen_down_mm'] / 1000:9.3f} m, {strokes}",
        f"  pen up     {spoken_duration(values['pen_up_s']):>12}   {values['pen_up_mm'] / 1000:9.3f} m",
        f"  pen lifts  {spoken_duration(values['pen_lift_s']):>12}   {lifts:9d}",
        f"  drawn area   x {left:.1f} to {right:.1f} mm, y {top:.1f} to {bottom:.1f} mm",
    ]
    if values["slowed_s"] >= _WORTH_SAYING * values["duration_s"]:
        least = f"{job.settings.lead:g} s"
        slowed = f"dense motion is slowed down so that the board always has {least} of it (--lead)"
        lines.append(f"  slowed     {spoken_duration(values['slowed_s']):>12}   {slowed}")
    lines += _pauses_said(values["pauses_at"], values["strokes"])
    if len(values["layers"]) > 1:
        lines += [
            f"  layer {t['number']} {t['name']}: {spoken_duration(t['duration_s'])}, {counted(t['strokes'], 'stroke')},"
            f" {t['pen_down_mm'] / 1000:.3f} m"
            for t in values["layers"]
        ]
    if output is not None:
        lines.append(f"  picture    {output}")
    return "\n".join(lines)


def _pauses_said(pauses: list[dict[str, Any]], strokes: int) -> list[str]:
    """How many pauses there are and where, those with the same message together."""
    places: dict[str, list[int]] = {}
    for pause in pauses:
        places.setdefault(pause["message"], []).append(pause["before_stroke"])
    lines = [f"  pauses     {'':12}   {len(pauses):9}, whose length is not in the times"] if pauses else []
    return lines + [f"    '{message}' {_before_said(numbers)} of {strokes}" for message, numbers in places.items()]


def _before_said(numbers: list[int]) -> str:
    """Before which strokes, numbered from 1."""
    shown = ", ".join(str(number) for number in numbers[:_MOST_PAUSES]) + (", ..." if len(numbers) > _MOST_PAUSES else "")
    return f"before stroke {shown}" if len(numbers) == 1 else f"{len(numbers)} times, before strokes {shown}"
