"""`plotter export`: the board's commands as a file that can be looked at, verified and sent by itself."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import click

from output.ebb.command_file import write_command_file
from plotter.cli.options import collect, settings_options
from plotter.cli.reading import collect_reading, reading_options
from plotter.cli.say import notes
from plotter.errors import BadInput
from plotter.estimate import Estimate
from plotter.pipeline import Job, board_setup, planned, prepare, program
from plotter.units import spoken_duration


@click.command()
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
    resolved = collect(options)
    job = prepare(file, collect_reading(options), resolved.values)
    notes(job.notes)
    estimate = Estimate()
    body = io.StringIO()
    setup = board_setup(job.settings, job.machine)
    write_command_file(body, {}, estimate.program(program(estimate.plan(planned(job)), setup)))
    head = io.StringIO()
    write_command_file(head, _header(job, estimate, resolved.origin), ())
    text = head.getvalue() + body.getvalue().split("\n", 1)[1]
    if output == "-":
        click.echo(text, nl=False)
        return
    try:
        Path(output).write_text(text, encoding="utf-8")
    except OSError as error:
        raise BadInput(f"cannot write {output}: {error.strerror}; give another file with -o") from None
    click.echo(f"{output}: {estimate.commands} commands, {spoken_duration(estimate.total.duration_s)}")


def _header(job: Job, estimate: Estimate, origin: Any) -> dict[str, object]:
    changed = {key: value for key, value in job.settings.model_dump().items() if origin[key] != "default"}
    return {
        "machine": job.machine.name,
        "firmware": job.settings.firmware,
        "drawing": f"{job.name} sha256 {job.digest}",
        "settings": " ".join(f"{key}={value}" for key, value in changed.items()),
        "duration_s": f"{estimate.total.duration_s:.2f}",
        "strokes": estimate.total.strokes,
        "commands": estimate.commands,
    }
