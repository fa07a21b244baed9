"""An SVG document to a Drawing."""

from __future__ import annotations

import gc
import sys
from pathlib import Path
from typing import Any

from planning.geometry.stroke import Layer
from planning.geometry.strokes import Strokes
from plotter.errors import BadInput
from plotter.svg.assemble import Assembly
from plotter.svg.blame import not_finite
from plotter.svg.document import parse_document
from plotter.svg.drawing import Drawing, LayerFacts
from plotter.svg.layers import FileLayer, Layering, pauses
from plotter.svg.lengths import NotFinite
from plotter.svg.notes import Notes
from plotter.svg.options import ReadOptions
from plotter.svg.style import Cascade
from plotter.svg.stylesheet import Stylesheet
from plotter.svg.text import draw_texts
from plotter.svg.walk import Walk

_FRAMES = 4000


def read_drawing(source: Path | bytes, options: ReadOptions | None = None) -> Drawing:
    """The strokes of an SVG or gzipped SVG file, or of its bytes, in document order and page millimetres.

    Curves are flattened within `options.tolerance_mm`; `Stroke.corners` is True at ends and where the outline itself turns,
    False where a smooth curve was flattened or segments join smoothly. Nothing outside the document is read.

    Raises BadInput, with one sentence, for a document that cannot be read, is not finite or exceeds a budget.
    """
    options = options or ReadOptions()
    usual, collecting = sys.getrecursionlimit(), gc.isenabled()
    # The walk takes up to five frames for each level of nesting, whose budget is checked as it goes.
    sys.setrecursionlimit(max(usual, _FRAMES))
    # Looking for garbage among hundreds of thousands of elements, of which none is, takes a sixth of the time.
    gc.disable()
    try:
        return _read(source, options)
    except RecursionError:
        raise BadInput(
            f"{_name(source)} is nested too deeply somewhere (style sheet, text or clip paths); simplify it"
        ) from None
    finally:
        sys.setrecursionlimit(usual)
        if collecting:
            gc.enable()


def _read(source: Path | bytes, options: ReadOptions) -> Drawing:
    notes = Notes()
    root = parse_document(_load(source, options), _name(source), options.budgets, notes)
    cascade = Cascade(Stylesheet(root, _style_texts(root), notes, options.budgets.selector_tests))
    layering = Layering(root, options.layers, notes)
    walk = Walk(root, cascade, layering, options, notes)
    try:
        return _drawing(walk, layering, options, notes)
    except NotFinite as error:  # of an element that the walk was not at: the root's own, or a text's
        raise not_finite(walk, str(error)) from None


def _drawing(walk: Walk, layering: Layering, options: ReadOptions, notes: Notes) -> Drawing:
    walk.run()
    draw_texts(walk)
    made = walk.collector.finish()
    assembly = Assembly(options, notes, (walk.width_mm, walk.height_mm), walk.collector.shapes)
    strokes = assembly.strokes(made, len(layering.layers))
    found = list(zip(layering.layers, strokes, strict=True))
    pausing = pauses((layer, len(drawn)) for layer, drawn in found)
    layers = tuple(
        _layer(number, layer, drawn, pause)
        for number, ((layer, drawn), pause) in enumerate(zip(found, pausing, strict=True), 1)
        if len(drawn)
    )
    followed = max((layer.number for layer in layers), default=0)
    facts = tuple(
        LayerFacts(
            number,
            layer.name,
            len(drawn),
            layer.hidden,
            layer.locked,
            layer.is_documentation,
            layer.pause_before and number <= followed and (bool(len(drawn)) or not layer.hidden),
        )
        for number, (layer, drawn) in enumerate(found, 1)
    )
    return Drawing(walk.width_mm, walk.height_mm, layers, notes.sentences(), facts)


def _name(source: Path | bytes) -> str:
    return "the drawing" if isinstance(source, bytes) else source.name


def source_bytes(file: str, options: ReadOptions) -> tuple[str, bytes]:
    """The name and bytes of a drawing's file; `-` is standard input. Never reads further than the byte budget.

    Raises BadInput for what cannot be read or is larger than that.
    """
    limit = options.budgets.document_bytes
    if file == "-":
        return "standard input", sys.stdin.buffer.read(limit + 1)
    path = Path(file)
    return path.name, _load(path, options)


def _load(source: Path | bytes, options: ReadOptions) -> bytes:
    if isinstance(source, bytes):
        return source
    limit = options.budgets.document_bytes
    try:
        size = source.stat().st_size
        if size > limit:
            raise BadInput(f"{source.name} has {size} bytes and the limit is {limit}; raise --max-bytes if it is meant")
        with source.open("rb") as file:
            return file.read(limit + 1)
    except OSError as error:
        raise BadInput(f"{source} cannot be read: {error.strerror or error}; check the path") from None


def _style_texts(root: Any) -> list[str]:
    tag = root.tag.rpartition("}")
    return [
        "".join(style.itertext())
        for style in root.iter(f"{tag[0]}{tag[1]}style")
        if style.get("type") in (None, "", "text/css")
    ]


def _layer(number: int, layer: FileLayer, strokes: Strokes, pause: tuple[str, ...] | None) -> Layer:
    colors = strokes.colors
    return Layer(number, layer.name, strokes, colors[0] if len(colors) == 1 else None, pause is not None, pause or ())
