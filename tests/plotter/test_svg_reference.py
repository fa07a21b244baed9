"""Outlines against those that a browser drew: every file of tests/data/svg must agree to 0.99."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from plotter.svg import font_engine
from plotter.svg.read import read_drawing

HERE = Path(__file__).resolve().parent.parent
FOLDER = HERE / "data" / "svg"
FILES = sorted(FOLDER.glob("*.svg"))


def _tool() -> Any:
    spec = importlib.util.spec_from_file_location("svg_refcheck", HERE / "tools" / "svg_refcheck.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


REFCHECK = _tool()


def score(points: list[np.ndarray], width_mm: float, height_mm: float, file: Path) -> dict[str, Any]:
    offsets = np.concatenate(([0], np.cumsum([len(one) for one in points]))).astype(int)
    every = np.concatenate(points) if points else np.zeros((0, 2))
    reference = FOLDER / "ref" / f"{file.stem}.png"
    return REFCHECK.check(every, offsets, width_mm, height_mm, str(reference), str(reference.with_suffix(".json")))


def has_fonts() -> bool:
    return font_engine.available() and "DejaVu Sans" in font_engine.families()


def test_there_are_48_files() -> None:
    assert len(FILES) == 48


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_outlines_agree_with_the_browser(file: Path) -> None:
    if b"<text" in file.read_bytes() and not has_fonts():
        pytest.skip("the browser drew this text in DejaVu Sans; it needs the extra `text` and that font")
    drawing = read_drawing(file)
    points = [stroke.points_mm for layer in drawing.layers for stroke in layer.strokes]
    result = score(points, drawing.width_mm, drawing.height_mm, file)
    assert result["size_ok"]
    assert result["score"] >= 0.99, result


def test_the_oracle_sees_a_shifted_drawing() -> None:
    file = FOLDER / "vpype__benchmark-300_beziers.svg"
    drawing = read_drawing(file)
    points = [stroke.points_mm + 1.0 for layer in drawing.layers for stroke in layer.strokes]
    assert score(points, drawing.width_mm, drawing.height_mm, file)["score"] < 0.7
