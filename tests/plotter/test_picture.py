"""Pictures of plans: ink where the pen was down, pale lines where it was up, true to the motion, at any size."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from lxml import etree
from PIL import Image
from shapely import LineString, Point

from planning.motion.plan import Action, Draw, LayerStart, Lift, Lower, Motion, Travel, still
from plotter.errors import BadInput
from plotter.preview.picture import draw_ink, draw_picture
from plotter.preview.sheet import LEGEND_HEIGHT_MM
from plotter.preview.table import Table
from plotter.preview.trace import flatten

TABLE = Table((100.0, 60.0))
SVG = "{http://www.w3.org/2000/svg}"
DPI = 254.0  # ten pixels per millimetre
RED, GREEN = (200, 0, 0), (0, 140, 0)


def hermite(points: np.ndarray, velocities: np.ndarray, piece_s: float) -> Motion:
    """A motion with a cubic piece between each two of the points, with the given velocities there."""
    p0, p1, v0, v1 = points[:-1], points[1:], velocities[:-1], velocities[1:]
    acceleration = (6 * (p1 - p0) / piece_s - 4 * v0 - 2 * v1) / piece_s
    jerk = (6 * (v0 + v1) - 12 * (p1 - p0) / piece_s) / piece_s**2
    return Motion(np.full(len(p0), piece_s), p0, v0, acceleration, jerk, points[-1])


def straight(*points: tuple[float, float]) -> Motion:
    at = np.array(points, dtype=np.float64)
    return hermite(at, np.zeros_like(at), 0.5)


def circle(center: tuple[float, float], radius: float, pieces: int = 8) -> Motion:
    t = np.linspace(0, 2 * np.pi, pieces + 1)
    points = np.array(center) + radius * np.column_stack((np.cos(t), np.sin(t)))
    velocities = radius * np.column_stack((-np.sin(t), np.cos(t)))
    return hermite(points, velocities, float(t[1]))


def plan() -> list[Action]:
    return [
        LayerStart(1, "red & round"),
        Travel(straight((0, 0), (40, 30))),
        Lower(0.1, 0),
        Draw(circle((30, 30), 10), 0),
        Lift(0.1),
        LayerStart(2, "green"),
        Travel(straight((40, 30), (60, 50))),
        Lower(0.1, 1),
        Draw(straight((60, 50), (60, 10), (90, 10)), 1),
        Lift(0.1),
        Travel(straight((90, 10), (95, 55))),
        Lower(0.1, 2),
        Draw(still(np.array([95.0, 55.0])), 2),
        Lift(0.1),
        Travel(straight((95, 55), (0, 0))),
    ]


COLORS = {1: "#c80000", 2: "#008c00"}


def read_png(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def near(pixels: np.ndarray, x_mm: float, y_mm: float, color: tuple[int, int, int], reach: int = 1) -> bool:
    """Whether a pixel within `reach` of the place, 5 mm of margin added, is about the colour."""
    column, row = int((x_mm + 5) * 10), int((y_mm + 5) * 10)
    window = pixels[row - reach : row + reach + 1, column - reach : column + reach + 1]
    return bool((np.abs(window - color).max(axis=2) < 40).any())


def test_png_has_the_ink_where_the_pen_was_down_and_nowhere_else(tmp_path: Path) -> None:
    draw_picture(tmp_path / "p.png", plan(), TABLE, dpi=DPI, layer_colors=COLORS)
    pixels = read_png(tmp_path / "p.png")
    assert pixels.shape == (int((60 + 10 + LEGEND_HEIGHT_MM) * 10), (100 + 10) * 10, 3)
    for angle in np.linspace(0, 2 * np.pi, 50):
        assert near(pixels, 30 + 10 * np.cos(angle), 30 + 10 * np.sin(angle), RED)
    for x, y in [(60, 45), (60, 10), (75, 10), (90, 10), (95, 55)]:
        assert near(pixels, x, y, GREEN), (x, y)
    strong = np.argwhere(pixels[:700].min(axis=2) < 60)  # ink, not travels or the page's edge
    x, y = strong[:, 1] / 10 - 5, strong[:, 0] / 10 - 5
    gap = np.minimum.reduce(
        [
            np.abs(np.hypot(x - 30, y - 30) - 10),
            np.where((y > 9) & (y < 51), np.abs(x - 60), 99),
            np.where((x > 59) & (x < 91), np.abs(y - 10), 99),
            np.hypot(x - 95, y - 55),
        ]
    )
    assert gap.max() < 0.35


def test_png_shows_travels_pale_and_is_antialiased(tmp_path: Path) -> None:
    draw_picture(tmp_path / "p.png", plan(), TABLE, dpi=DPI, layer_colors=COLORS)
    pixels = read_png(tmp_path / "p.png")
    on_travel = pixels[450 - 2 : 450 + 3, 550]  # (50, 40), between the two strokes
    assert on_travel.min() < 230
    assert on_travel.min() > 120
    shades = np.unique(pixels[:700, :, 1][(pixels[:700, :, 0] > 200) & (pixels[:700, :, 1] < 250)])
    assert len(shades) > 5


def test_svg_holds_every_stroke_within_tolerance(tmp_path: Path) -> None:
    draw_picture(tmp_path / "p.svg", plan(), TABLE, layer_colors=COLORS, stroke_colors=[None, "#123456", None])
    root = etree.parse(tmp_path / "p.svg").getroot()
    assert root.get("width") == "110.000mm"
    assert root.get("viewBox", "").split()[:2] == ["-5.000", "-5.000"]
    groups = root.findall(f"{SVG}g")
    label = "{http://www.inkscape.org/namespaces/inkscape}label"
    assert [(g.get("class"), g.get(label)) for g in groups] == [("travel", "pen up"), ("ink", "red & round"), ("ink", "green")]
    assert [len(g) for g in groups] == [4, 1, 2]
    assert groups[1].get("stroke") == "#c80000"
    assert groups[2].get("stroke") == "#123456"
    assert groups[2][1].get("stroke") == "#008c00"

    lines = [[np.array(line.get("points").replace(",", " ").split(), float).reshape(-1, 2) for line in g] for g in groups]
    drawn = [action.motion for action in plan() if isinstance(action, Draw)]
    for motion, points in zip(drawn, [lines[1][0], *lines[2]], strict=True):
        path, _, _, _ = motion.sample(np.linspace(0, motion.total_s, 2000))
        polyline = LineString(points)
        assert max(polyline.distance(Point(p)) for p in path) < 0.011
        dense = LineString(path if len(path) > 1 else np.vstack((path, path)))
        assert max(dense.distance(Point(p)) for p in points) < 0.011
        np.testing.assert_allclose([points[0], points[-1]], [motion.start_mm, motion.end_mm], atol=6e-4)


@pytest.mark.parametrize("pieces", [4, 7, 64])
@pytest.mark.parametrize("tolerance_mm", [0.2, 0.01, 0.001])
def test_flatten_stays_within_its_tolerance_without_waste(pieces: int, tolerance_mm: float) -> None:
    motion = circle((0, 0), 20, pieces)
    points = flatten(motion, tolerance_mm)
    path, _, _, _ = motion.sample(np.linspace(0, motion.total_s, 3000))
    polyline = LineString(points)
    assert max(polyline.distance(Point(p)) for p in path) <= tolerance_mm * 1.000001
    fewest = np.pi / np.arccos(1 - tolerance_mm / 20)
    assert len(points) < 4 * fewest + pieces


def test_flatten_of_a_straight_motion_is_two_points_whatever_its_speed() -> None:
    np.testing.assert_array_equal(flatten(straight((1, 2), (31, 42)), 0.01), [[1, 2], [31, 42]])


def test_draw_ink_draws_the_polylines_it_is_given(tmp_path: Path) -> None:
    strokes = [
        np.array([[10.0, 10.0], [50.0, 10.0]]),
        np.empty((0, 2)),
        np.array([[70.0, 40.0]]),
        np.array([[10.0, 50.0], [90.0, 50.0]]),
    ]
    draw_ink(tmp_path / "i.png", strokes, TABLE, dpi=DPI, colors=["#c80000", None, None, "#ffffff"])
    pixels = read_png(tmp_path / "i.png")
    assert near(pixels, 30, 10, RED)
    assert near(pixels, 70, 40, (34, 34, 34))
    assert near(pixels, 50, 50, (176, 176, 176))  # white ink on white paper is shown grey
    assert (pixels[170:430, 60:700] == 255).all()


def test_a_page_of_metres_stays_within_its_pixels_and_memory(tmp_path: Path) -> None:
    t = np.linspace(0, 200 * np.pi, 60_000)
    spiral = np.column_stack((1500 + t * 2 * np.cos(t), 1000 + t * 1.5 * np.sin(t)))
    draw_ink(tmp_path / "small.png", [spiral / 30], TABLE)  # loads what is loaded on first use
    tracemalloc.start()
    draw_ink(tmp_path / "i.png", [spiral], Table((3000, 2000)), dpi=600)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    with Image.open(tmp_path / "i.png") as image:
        assert 30e6 < image.width * image.height <= 36.1e6
        assert image.width / image.height == pytest.approx(3010 / 2018, rel=0.01)
    assert peak < 60e6  # numpy's share: no array grows with the picture


def test_bounds_beyond_the_page_are_shown(tmp_path: Path) -> None:
    draw_picture(tmp_path / "p.png", [], TABLE, bounds_mm=(-20, 0, 120, 80), dpi=25.4)
    with Image.open(tmp_path / "p.png") as image:
        assert image.size == (150, 90 + LEGEND_HEIGHT_MM)


def test_the_page_and_the_well_are_shown_where_they_lie(tmp_path: Path) -> None:
    """A page that is turned, moved and partly off the machine, the well at its other end."""
    table = Table((100.0, 60.0), np.array([[70.0, 10.0], [20.0, 70.0]]), np.array([90.0, 30.0]))
    draw_picture(tmp_path / "p.png", [], table, dpi=DPI)
    pixels = read_png(tmp_path / "p.png")
    assert pixels.shape == (int((70 + 10 + LEGEND_HEIGHT_MM) * 10), (100 + 10) * 10, 3)
    grey, pale, blue = (138, 138, 138), (212, 212, 212), (42, 127, 158)
    for along in np.linspace(0.02, 0.98, 20):
        for x, y in [(20, 10 + 60 * along), (70, 10 + 60 * along), (20 + 50 * along, 10), (20 + 50 * along, 70)]:
            assert near(pixels, x, y, grey), (x, y)
        assert near(pixels, 0, 60 * along, pale)
    for turn in np.linspace(0, 2 * np.pi, 16):
        assert near(pixels, 90 + 2.5 * np.cos(turn), 30 + 2.5 * np.sin(turn), blue)
    assert near(pixels, 90, 30, blue)
    draw_picture(tmp_path / "p.svg", [], table)
    root = etree.parse(tmp_path / "p.svg").getroot()
    shown = {line.get("class"): line.get("points").split() for line in root.iter(f"{SVG}polyline")}
    assert set(shown) == {"machine", "page", "well"}
    assert set(shown["page"]) == {"20.000,10.000", "70.000,10.000", "70.000,70.000", "20.000,70.000"}
    words = "".join(root.find(f"{SVG}text").itertext())
    assert "machine 100 x 60 mm" in words and "page 50 x 60 mm" in words and "well at 90, 30 mm" in words


def test_a_page_of_a_hall_does_not_make_the_machine_a_dot(tmp_path: Path) -> None:
    table = Table((100.0, 60.0), np.array([[0.0, 0.0], [50_000.0, 30_000.0]]))
    draw_picture(tmp_path / "p.png", [], table, dpi=25.4)
    with Image.open(tmp_path / "p.png") as image:
        assert image.size == (160, 100 + LEGEND_HEIGHT_MM)


@pytest.mark.parametrize("name", ["p.jpg", "p"])
def test_a_name_of_another_kind_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(BadInput, match=r"must end in \.png or \.svg"):
        draw_picture(tmp_path / name, plan(), TABLE)
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize("name", ["p.png", "p.svg"])
def test_a_place_that_cannot_be_written_is_bad_input(tmp_path: Path, name: str) -> None:
    with pytest.raises(BadInput, match="cannot be written"):
        draw_picture(tmp_path / "missing" / name, plan(), TABLE)
