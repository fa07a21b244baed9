"""Placing the page on the machine."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planning.geometry.stroke import Layer, Stroke
from plotter.arrange import arrange, bounds_mm
from plotter.errors import BadInput
from plotter.machines.profile import load_machine
from plotter.settings import Settings, resolve
from plotter.svg.drawing import Drawing

MACHINE = load_machine("axidraw-v3")


@pytest.fixture
def empty(tmp_path: Path) -> Path:
    file = tmp_path / "settings.toml"
    file.write_text("")
    return file


def page(width_mm: float, height_mm: float, *polylines: list[list[float]]) -> Drawing:
    strokes = tuple(Stroke(np.array(line, dtype=float)) for line in polylines)
    return Drawing(width_mm, height_mm, (Layer(1, "all", strokes),))


def settings(empty: Path, **flags: object) -> Settings:
    return resolve(flags, empty).values


def test_a_page_that_fits_stays_where_it_is(empty: Path) -> None:
    drawing = page(200, 100, [[1, 2], [3, 4]])
    placed = arrange(drawing, settings(empty), MACHINE)
    assert placed.layers is drawing.layers
    assert placed.notes == ()


def test_a_portrait_page_is_turned_and_says_so(empty: Path) -> None:
    placed = arrange(page(210, 297, [[0, 0], [210, 0], [210, 297]]), settings(empty), MACHINE)
    np.testing.assert_allclose(placed.layers[0].strokes[0].points_mm, [[297, 0], [297, 210], [0, 210]])
    assert placed.page_mm == (297, 210)
    assert "--rotate 0" in placed.notes[0]


@pytest.mark.parametrize(
    ("degrees", "expected"),
    [("0", [10, 20]), ("90", [80, 10]), ("180", [190, 80]), ("270", [20, 190])],
)
def test_quarter_turns_are_clockwise(degrees: str, expected: list[float], empty: Path) -> None:
    placed = arrange(page(200, 100, [[10, 20], [11, 20]]), settings(empty, rotate=degrees), MACHINE)
    np.testing.assert_allclose(placed.layers[0].strokes[0].points_mm[0], expected)


def test_four_turns_come_back(empty: Path) -> None:
    drawing = page(100, 100, [[10, 20], [30, 5], [7, 90]])
    original = drawing.layers[0].strokes[0].points_mm
    for _ in range(4):
        placed = arrange(drawing, settings(empty, rotate="90"), MACHINE)
        drawing = Drawing(*placed.page_mm, placed.layers)
    np.testing.assert_allclose(drawing.layers[0].strokes[0].points_mm, original, atol=1e-9)


def test_fit_fills_the_travel_within_the_margin(empty: Path) -> None:
    placed = arrange(page(50, 50, [[10, 10], [20, 10], [20, 15]]), settings(empty, fit=True, margin="5mm"), MACHINE)
    left, top, right, bottom = bounds_mm(placed.layers) or (0, 0, 0, 0)
    assert (left, right) == pytest.approx((5, 295))
    assert (top + bottom) / 2 == pytest.approx(109)
    assert (right - left) / (bottom - top) == pytest.approx(2)


@pytest.mark.parametrize("rotate", ["0", "90", "180", "270"])
@pytest.mark.parametrize("changes", [{}, {"scale": 0.37}, {"fit": True, "margin": "7mm"}, {"offset_x": "3.3", "scale": 1.7}])
def test_the_bounds_are_those_of_the_placed_strokes(rotate: str, changes: dict[str, Any], empty: Path) -> None:
    drawing = page(90, 70, *np.random.default_rng(1).uniform(3, 60, (20, 3, 2)).tolist())
    placed = arrange(drawing, settings(empty, rotate=rotate, **changes), MACHINE)
    assert placed.bounds_mm == bounds_mm(placed.layers), "to the last bit: what lies on the border must not lie beyond it"


def test_scale_and_offset(empty: Path) -> None:
    placed = arrange(page(50, 50, [[1, 2], [3, 4]]), settings(empty, scale=2, offset_x="10", offset_y="1cm"), MACHINE)
    np.testing.assert_allclose(placed.layers[0].strokes[0].points_mm, [[12, 14], [16, 18]])
    np.testing.assert_allclose(placed.placement.back(placed.layers[0].strokes[0].points_mm), [[1, 2], [3, 4]])


def test_nothing_to_draw_is_refused(empty: Path) -> None:
    with pytest.raises(BadInput, match="no strokes"):
        arrange(page(10, 10), settings(empty), MACHINE)


def test_a_margin_without_room_is_refused(empty: Path) -> None:
    with pytest.raises(BadInput, match="--margin 150mm"):
        arrange(page(10, 10, [[0, 0], [1, 1]]), settings(empty, fit=True, margin="150mm"), MACHINE)
