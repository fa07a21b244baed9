"""`plotter preview`: how long a drawing takes, of what, and a picture of where the pen goes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from planning.motion.plan import Action
from plotter.cli.options import collect, settings_options
from plotter.cli.reading import collect_reading, reading_options
from plotter.cli.say import notes
from plotter.estimate import Estimate, Tally
from plotter.pipeline import Job, board_setup, planned, prepare, program
from plotter.preview.picture import draw_picture
from plotter.units import spoken_duration


@click.command()
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
    settings = collect(options).values
    job = prepare(file, collect_reading(options), settings)
    notes(job.notes)
    estimate = Estimate()
    if output is None:
        for _ in _estimated(job, planned(job), estimate):
            pass
    else:
        _draw(job, estimate, output)
    click.echo(json.dumps(_facts(job, estimate), indent=2) if as_json else _report(job, estimate, output))


def _estimated(job: Job, actions: Iterator[Action], estimate: Estimate) -> Iterator[object]:
    return estimate.program(program(estimate.plan(actions), board_setup(job.settings, job.machine)))


def _draw(job: Job, estimate: Estimate, output: Path) -> None:
    """The picture and the estimate from one pass over the plan."""
    actions = list(planned(job))
    for _ in _estimated(job, iter(actions), estimate):
        pass
    draw_picture(
        output,
        actions,
        (job.machine.width_mm, job.machine.height_mm),
        layer_colors={layer.number: layer.color for layer in job.layers},
        stroke_colors=[stroke.color for layer in job.layers for stroke in layer.strokes],
    )


def _facts(job: Job, estimate: Estimate) -> dict[str, Any]:
    return {
        "file": job.name,
        "machine": job.machine.name,
        **_rounded(estimate.total),
        "layers": [{"number": t.number, "name": t.name, **_rounded(t)} for t in estimate.layers],
        "bounds_mm": [round(value, 4) for value in estimate.bounds_mm],
        "commands": estimate.commands,
    }


def _rounded(tally: Tally) -> dict[str, Any]:
    facts = {key: value for key, value in asdict(tally).items() if key not in ("number", "name")}
    return {key: round(value, 4) for key, value in {"duration_s": tally.duration_s, **facts}.items()}


def _report(job: Job, estimate: Estimate, output: Path | None) -> str:
    total = estimate.total
    left, top, right, bottom = estimate.bounds_mm
    lines = [
        f"{job.name} on {job.machine.title}",
        f"  total      {spoken_duration(total.duration_s):>12}",
        f"  pen down   {spoken_duration(total.pen_down_s):>12}   {total.pen_down_mm / 1000:9.3f} m in {total.strokes} strokes",
        f"  pen up     {spoken_duration(total.pen_up_s):>12}   {total.pen_up_mm / 1000:9.3f} m",
        f"  pen lifts  {spoken_duration(total.pen_lift_s):>12}   {total.pen_lifts:9d}",
        f"  drawn area   x {left:.1f} to {right:.1f} mm, y {top:.1f} to {bottom:.1f} mm",
    ]
    if len(estimate.layers) > 1:
        lines += [
            f"  layer {t.number} {t.name}: {spoken_duration(t.duration_s)}, {t.strokes} strokes, {t.pen_down_mm / 1000:.3f} m"
            for t in estimate.layers
        ]
    if output is not None:
        lines.append(f"  picture    {output}")
    return "\n".join(lines)
