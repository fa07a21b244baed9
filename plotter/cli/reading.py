"""`plotter layers` and `plotter strokes`, and the flags that say how a drawing is read, for every command that reads one."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast, get_args

import click
import numpy as np

from output.wording import counted
from plotter.cli.help import HeadedCommand, HeadedOption, Heading
from plotter.cli.outputs import spare
from plotter.cli.say import notes
from plotter.errors import BadInput
from plotter.svg.drawing import Drawing
from plotter.svg.options import Budgets, Fills, Hidden, LayerRule, ReadOptions, Text
from plotter.svg.read import read_drawing, source_bytes
from plotter.units import length_mm

Command = TypeVar("Command", bound=Callable[..., Any])
Decorator = Callable[[Any], Any]

_DEFAULT = ReadOptions()
_BUDGET_FLAGS = {
    "document_bytes": ("--max-bytes", "bytes of the file, and of what it unpacks to"),
    "elements": ("--max-elements", "elements, counting what each <use> repeats"),
    "nesting": ("--max-nesting", "levels of nesting, at most 400"),
    "uses": ("--max-uses", "expanded <use> elements"),
    "markers": ("--max-markers", "drawn markers"),
    "points": ("--max-points", "points of all polylines"),
    "dashes": ("--max-dashes", "dashes"),
    "characters": ("--max-characters", "characters of text"),
    "selector_tests": ("--max-selector-tests", "tests of a style selector on an element"),
}


def _length(ctx: click.Context, param: click.Parameter, value: str) -> float:
    try:
        return length_mm(value)
    except ValueError as error:
        raise click.BadParameter(str(error), ctx, param) from None


def _flags() -> list[Decorator]:
    def reading(flag: str, name: str, heading: Heading = Heading.READING, **attributes: Any) -> Decorator:
        return click.option(flag, f"read_{name}", cls=HeadedOption, heading=heading, **attributes)

    def choice(flag: str, name: str, kinds: Any, default: str, text: str) -> Decorator:
        return reading(flag, name, type=click.Choice(get_args(kinds)), default=default, show_default=True, help=text)

    flags: list[Decorator] = [
        choice("--text", "text", Text, _DEFAULT.text, "Text: outlines of its glyphs; single-line strokes; or left out."),
        choice(
            "--layers",
            "layers",
            LayerRule,
            _DEFAULT.layers,
            "What a layer is: Inkscape's layers, else top-level groups (auto); one of these; or one for all.",
        ),
        choice(
            "--fills",
            "fills",
            Fills,
            _DEFAULT.fills,
            "Filled shapes: as outlines; also with the closing line that a fill implies; or left out where only filled.",
        ),
        choice(
            "--hidden",
            "hidden",
            Hidden,
            _DEFAULT.hidden,
            "What is not painted: left out; drawn where it merely has no fill and stroke; or all of it, also display:none.",
        ),
        reading("--occlude", "occlude", is_flag=True, help="Hide what lies under opaque fills."),
        reading("--crop", "crop", is_flag=True, help="Cut the drawing at the page's edge."),
        reading(
            "--dpi",
            "px_per_in",
            type=click.FloatRange(1, 10_000),
            default=_DEFAULT.px_per_in,
            show_default="96",
            help="Pixels per inch: 96 by the standard, 72 for files of old Illustrator.",
        ),
        reading(
            "--tolerance-curve",
            "tolerance_mm",
            callback=_length,
            metavar="LENGTH",
            default=f"{_DEFAULT.tolerance_mm:g}mm",
            show_default=True,
            help="How far a curve's polyline may lie from the curve; 0.0001mm to 10mm.",
        ),
    ]
    for name, (flag, what) in _BUDGET_FLAGS.items():
        flags.append(
            reading(
                flag,
                f"max_{name}",
                Heading.LIMITS,
                type=click.IntRange(1, 400 if name == "nesting" else None),
                default=getattr(_DEFAULT.budgets, name),
                show_default=True,
                metavar="N",
                help=f"Refuse a drawing with more {what}.",
            )
        )
    return flags


def reading_options(command: Command) -> Command:
    """Give `command` the flags that say how a drawing is read. `collect_reading` turns them into ReadOptions."""
    decorated: Any = command
    for flag in reversed(_flags()):
        decorated = flag(decorated)
    return cast(Command, decorated)


def collect_reading(options: dict[str, Any]) -> ReadOptions:
    """ReadOptions from a command's options, which loses them: what is left belongs to the command. Raises BadInput."""
    given = {name.removeprefix("read_"): options.pop(name) for name in list(options) if name.startswith("read_")}
    budgets = {name: given.pop(f"max_{name}") for name in _BUDGET_FLAGS if f"max_{name}" in given}
    try:
        return ReadOptions(**given, budgets=Budgets(**budgets))
    except ValueError as error:
        raise BadInput(str(error)) from None


def read_file(file: str, options: ReadOptions) -> Drawing:
    """The drawing of `file`, `-` being standard input; its notes go to stderr. Raises BadInput."""
    drawing = read_drawing(Path(file) if file != "-" else source_bytes(file, options)[1], options)
    notes(drawing.warnings)
    return drawing


@click.command(cls=HeadedCommand)
@click.argument("file", metavar="FILE.svg")
@click.option("--json", "as_json", is_flag=True, help="For programs.")
@reading_options
def layers(file: str, as_json: bool, **options: Any) -> None:
    """List the layers of FILE.svg (- reads standard input) and what each holds.

    \b
    plotter layers drawing.svg
    plotter layers drawing.svg --json
    """
    drawing = read_file(file, collect_reading(options))
    rows = _rows(drawing)
    if as_json:
        click.echo(json.dumps({"width_mm": drawing.width_mm, "height_mm": drawing.height_mm, "layers": rows}, indent=2))
        return
    click.echo(f"page {drawing.width_mm:.2f} x {drawing.height_mm:.2f} mm, {counted(drawing.stroke_count, 'stroke')}")
    for row in rows:
        states = [state for state in ("hidden", "locked", "documentation", "pause_before") if row[state]]
        said = f"   {', '.join(states).replace('_', ' ')}" if states else ""
        colors = " ".join(row["colors"][:4]) + (" ..." if len(row["colors"]) > 4 else "")
        strokes = counted(row["strokes"], "stroke")
        click.echo(f"{row['number']:4}  {row['name']:24} {strokes:>16} {row['length_mm']:12.1f} mm   {colors}{said}")


def _rows(drawing: Drawing) -> list[dict[str, Any]]:
    drawn = {layer.number: layer for layer in drawing.layers}
    rows = []
    for facts in drawing.file_layers:
        strokes = drawn[facts.number].strokes if facts.number in drawn else ()
        points = [stroke.points_mm for stroke in strokes]
        box = None
        if points:
            every = np.concatenate(points)
            box = [round(float(value), 3) for value in (*every.min(axis=0), *every.max(axis=0))]
        rows.append(
            {
                "number": facts.number,
                "name": facts.name,
                "strokes": facts.strokes,
                "points": sum(map(len, points)),
                "length_mm": round(sum(stroke.length_mm for stroke in strokes), 3),
                "box_mm": box,
                "colors": sorted({stroke.color for stroke in strokes if stroke.color}),
                "hidden": facts.hidden,
                "locked": facts.locked,
                "documentation": facts.documentation,
                "pause_before": facts.pause_before,
            }
        )
    return rows


@click.command(cls=HeadedCommand)
@click.argument("file", metavar="FILE.svg")
@click.option("-o", "--output", required=True, metavar="POLY.json", help="Where to write; - writes standard output.")
@reading_options
def strokes(file: str, output: str, **options: Any) -> None:
    """Write the polylines of FILE.svg (- reads standard input) as they were read, before ordering and page fitting.

    \b
    plotter strokes drawing.svg -o drawing.json
    cat drawing.svg | plotter strokes - -o -

    The output is {"width_mm", "height_mm", "polylines": [[[x, y], ...], ...]} in document order, page millimetres.
    """
    spare({"drawing": file}, output)
    drawing = read_file(file, collect_reading(options))
    polylines = [stroke.points_mm.tolist() for layer in drawing.layers for stroke in layer.strokes]
    text = json.dumps({"width_mm": drawing.width_mm, "height_mm": drawing.height_mm, "polylines": polylines})
    if output == "-":
        click.echo(text)
        return
    try:
        Path(output).write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise BadInput(f"{output} cannot be written: {error.strerror or error}; give another place") from None
