"""The drawings of samples/: made again byte for byte, licensed, and what each promises to hold."""

from __future__ import annotations

import re
import subprocess
import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from planning.geometry.stroke import Stroke
from plotter.svg.drawing import Drawing
from plotter.svg.read import read_drawing

SAMPLES = Path(__file__).parents[2] / "samples"
FILES = sorted(SAMPLES.glob("*.svg"))
NAMES = [path.stem for path in FILES]
SLOW = {"stipple"}  # its packing takes half a minute
NEEDS_FONT = {"poster"}
TRAVEL_MM = np.array([300.0, 218.0])


@cache
def drawing(name: str) -> Drawing:
    return read_drawing(SAMPLES / f"{name}.svg")


def strokes(name: str) -> list[Stroke]:
    return [stroke for layer in drawing(name).layers for stroke in layer.strokes]


def path_data(name: str) -> str:
    root = ElementTree.parse(SAMPLES / f"{name}.svg").getroot()
    return " ".join(element.get("d", "") for element in root.iter("{http://www.w3.org/2000/svg}path"))


def make(names: list[str], out: Path) -> subprocess.CompletedProcess[str]:
    script = SAMPLES / "make_samples.py"
    return subprocess.run([sys.executable, script, *names, "--out", out], capture_output=True, text=True, check=False)


def assert_made_again(names: list[str], out: Path) -> None:
    done = make(names, out)
    assert done.returncode == 0, done.stderr
    assert sorted(path.stem for path in out.glob("*.svg")) == sorted(names)
    changed = [name for name in names if (out / f"{name}.svg").read_bytes() != (SAMPLES / f"{name}.svg").read_bytes()]
    assert not changed


def test_the_script_makes_them_again_byte_for_byte(tmp_path: Path) -> None:
    assert_made_again([name for name in NAMES if name not in SLOW | NEEDS_FONT], tmp_path)


@pytest.mark.long
def test_the_script_makes_the_slow_ones_again_byte_for_byte(tmp_path: Path) -> None:
    assert_made_again(sorted(SLOW), tmp_path)


@pytest.mark.skipif(not (find_spec("fontTools") and find_spec("font_source_serif_pro")), reason="needs fontTools and its font")
def test_the_poster_is_made_again_byte_for_byte(tmp_path: Path) -> None:
    assert_made_again(sorted(NEEDS_FONT), tmp_path)


def test_the_script_names_a_sample_it_does_not_know(tmp_path: Path) -> None:
    done = make(["rosete"], tmp_path)
    assert done.returncode == 2
    assert "no sample called 'rosete'" in done.stderr


def test_readme_says_of_each_file_why_and_under_which_licence() -> None:
    rows = re.findall(r"^\| (\w+)\.svg \| (.+) \| (.+) \|$", (SAMPLES / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(name for name, _, _ in rows) == NAMES
    assert all(len(why) > 30 for _, why, _ in rows)
    assert all(licence.startswith("CC0 1.0") for _, _, licence in rows)
    assert len(rows) >= 10


@pytest.mark.parametrize("name", NAMES)
def test_each_file_states_its_licence(name: str) -> None:
    text = (SAMPLES / f"{name}.svg").read_text(encoding="utf-8")
    assert "CC0 1.0" in text or "creativecommons.org/publicdomain/zero/1.0" in text


def test_they_stay_small_together() -> None:
    assert sum(path.stat().st_size for path in FILES) < 12_000_000


@pytest.mark.parametrize("name", NAMES)
def test_each_fits_its_page_and_the_default_machine(name: str) -> None:
    page = np.array([drawing(name).width_mm, drawing(name).height_mm])
    assert (page <= TRAVEL_MM).all()
    points = np.vstack([stroke.points_mm for stroke in strokes(name)])
    assert (points.min(axis=0) >= 0).all()
    assert (points.max(axis=0) <= page).all()
    assert np.ptp(points, axis=0).min() > 0.5 * page.min()  # it is a picture, not a speck: the scale was read right


@pytest.mark.parametrize(
    ("name", "width_mm", "height_mm"),
    [("contours", 297, 210), ("arcs", 279.4, 215.9), ("harbour", 297, 210), ("shapes", 210, 210)],
)
def test_cm_inch_and_mm_are_read_as_such(name: str, width_mm: float, height_mm: float) -> None:
    assert (drawing(name).width_mm, drawing(name).height_mm) == pytest.approx((width_mm, height_mm), abs=0.01)


def test_contours_has_more_than_50000_segments_on_three_layers() -> None:
    assert sum(len(stroke.points_mm) - 1 for stroke in strokes("contours")) > 50_000
    assert [layer.name for layer in drawing("contours").layers] == ["1 sea", "2 land", "3 index contours"]


def test_stipple_has_more_than_5000_short_strokes() -> None:
    circles = strokes("stipple")
    assert len(circles) > 5_000
    lengths = np.array([stroke.length_mm for stroke in circles])
    assert lengths.max() < 3.0
    assert lengths.min() > 1.0
    assert all(stroke.is_closed for stroke in circles)


def test_rosette_is_four_closed_smooth_curves_on_two_layers() -> None:
    assert [(layer.name, len(layer.strokes)) for layer in drawing("rosette").layers] == [("1 blue", 2), ("2 red", 2)]
    assert all(stroke.is_closed for stroke in strokes("rosette"))
    assert 4_500 < sum(stroke.length_mm for stroke in strokes("rosette")) < 6_500
    for stroke in strokes("rosette"):
        headings = np.unwrap(np.arctan2(*np.diff(stroke.points_mm, axis=0).T[::-1]))
        assert np.abs(np.diff(headings)).max() < np.radians(25)


def test_poster_is_text_in_cubic_and_quadratic_curves_without_text_elements() -> None:
    data = path_data("poster")
    assert data.count("C") > 100
    assert data.count("Q") > 2_000
    assert "<text" not in (SAMPLES / "poster.svg").read_text(encoding="utf-8")
    assert len(strokes("poster")) > 500
    assert all(stroke.is_closed for stroke in strokes("poster"))


def test_hilbert_is_one_stroke_that_never_crosses_itself() -> None:
    (stroke,) = strokes("hilbert")
    assert len(stroke.points_mm) > 10_000
    assert len(np.unique(stroke.points_mm, axis=0)) == len(stroke.points_mm)
    assert stroke.corners is None or stroke.corners.mean() > 0.5


def test_city_is_straight_lines() -> None:
    assert len(strokes("city")) > 2_000
    assert {len(stroke.points_mm) for stroke in strokes("city")} == {2}


def test_letter_draws_a_word_in_one_stroke() -> None:
    longest = max(strokes("letter"), key=lambda stroke: stroke.length_mm)
    assert longest.length_mm > 60
    assert 100 < len(strokes("letter")) < 200


def test_harbour_pauses_before_its_third_layer_and_hides_its_fourth() -> None:
    assert [(layer.name, layer.pause_before) for layer in drawing("harbour").layers] == [
        ("1 sea", False),
        ("2 boats and coast", False),
        ("!3 change to red", True),
    ]
    assert any("hidden" in warning for warning in drawing("harbour").warnings)


def test_shapes_uses_every_basic_shape() -> None:
    root = ElementTree.parse(SAMPLES / "shapes.svg").getroot()
    tags = [element.tag.rpartition("}")[2] for element in root.iter()]
    kinds = ("rect", "circle", "ellipse", "line", "polyline", "polygon")
    assert all(tags.count(kind) >= 2 for kind in kinds)
    assert "path" not in tags
    assert len(strokes("shapes")) == sum(tags.count(kind) for kind in kinds)


def test_arcs_has_every_combination_of_flags() -> None:
    flags = re.findall(r"A 18 11 (-?\d+) ([01]) ([01])", path_data("arcs"))
    assert {(large, sweep) for _, large, sweep in flags} == {("0", "0"), ("0", "1"), ("1", "0"), ("1", "1")}
    assert len({rotation for rotation, _, _ in flags}) == 5
    lengths = [stroke.length_mm for stroke in drawing("arcs").layers[0].strokes[:4]]
    whole = 92.5  # an ellipse of half-axes 18 and 11, by Ramanujan's formula
    assert lengths[0] + lengths[3] == pytest.approx(whole, rel=0.01)  # either pair makes the ellipse
    assert lengths[1] + lengths[2] == pytest.approx(whole, rel=0.01)
    assert max(lengths[:2]) < whole / 2 < min(lengths[2:])


def test_tree_nests_groups_and_uses_every_transform() -> None:
    root = ElementTree.parse(SAMPLES / "tree.svg").getroot()

    def depth(element: ElementTree.Element) -> int:
        return 1 + max((depth(child) for child in element), default=0)

    assert depth(root) >= 10
    used = " ".join(element.get("transform", "") for element in root.iter())
    assert all(f"{kind}(" in used for kind in ("matrix", "translate", "rotate", "scale", "skewX"))
    assert len(strokes("tree")) > 2_000
