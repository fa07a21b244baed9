"""What is done for each stroke of a large drawing before the first one moves: next to nothing. Counted, not timed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planning.geometry.stroke import Stroke
from plotter.pipeline import prepare
from plotter.settings import resolve
from plotter.svg.options import ReadOptions
from plotter.svg.read import read_drawing
from plotter.svg.walk import Walk

COUNT = 5000


def drawing(folder: Path, shape: str) -> Path:
    places = np.random.default_rng(1).uniform(5, 195, (COUNT, 2)).round(2).tolist()
    head = (
        '<svg xmlns="http://www.w3.org/2000/svg" width="200mm" height="200mm" viewBox="0 0 200 200" fill="none" stroke="black">'
    )
    file = folder / "drawing.svg"
    file.write_text(head + "".join(shape.format(x=x, y=y) for x, y in places) + "</svg>")
    return file


def test_strokes_are_made_of_the_opening_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = 0
    checked = Stroke.__post_init__

    def counted(stroke: Stroke) -> None:
        nonlocal made
        made += 1
        checked(stroke)

    monkeypatch.setattr(Stroke, "__post_init__", counted)
    # Turned and scaled, so that all strokes are placed as well.
    settings = resolve({"fit": True, "margin": "5mm", "rotate": "90"}).values
    job = prepare(str(drawing(tmp_path, '<path d="M{x} {y}l1 2"/>')), ReadOptions(), settings)
    assert job.drawing.stroke_count == COUNT
    assert made == 0
    first = next(iter(job.ordering))
    assert 0 < len(first.strokes) < COUNT / 5
    assert made < 10 * len(first.strokes)


@pytest.mark.parametrize(
    "shape", ['<line x1="{x}" y1="{y}" x2="9" y2="9"/>', '<circle cx="{x}" cy="{y}" r="1"/>', '<path d="M{x} {y}L9 9"/>']
)
def test_of_shapes_that_are_alike_a_few_are_looked_at(shape: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    looked = 0
    element = Walk.element

    def counted(walk: Walk, *about: Any) -> None:
        nonlocal looked
        looked += 1
        element(walk, *about)

    monkeypatch.setattr(Walk, "element", counted)
    assert read_drawing(drawing(tmp_path, shape)).stroke_count == COUNT
    assert looked == 2
