"""Whatever is done to a drawing's bytes, it is read or refused with a sentence; and laws of what is read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from plotter.errors import BadInput
from plotter.svg.cut import Piece, Region, cut, dash
from plotter.svg.options import Budgets, ReadOptions
from plotter.svg.read import read_drawing
from tests.plotter.svg_help import page, polylines

FILES = sorted(
    (file for file in (Path(__file__).resolve().parent.parent / "data" / "svg").glob("*.svg") if file.stat().st_size < 10_000),
    key=lambda file: file.name,
)
OPTIONS = ReadOptions(
    text="skip", occlude=True, crop=True, fills="close", hidden="all", budgets=Budgets(points=200_000, dashes=2000)
)

CUTS = st.lists(
    st.tuples(st.floats(0, 1), st.integers(0, 40), st.sampled_from(list('<>"/&#;%(){}0-9.eE,NnMmaZz \n\0\xff'))), max_size=6
)


def mutated(data: bytes, cuts: list[tuple[float, int, str]]) -> bytes:
    for where, length, text in cuts:
        at = int(where * len(data))
        data = data[:at] + text.encode("latin-1") * (length % 3) + data[at + length :]
    return data


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@example(FILES[0], [(0.5, 1, "\0")])
@given(st.sampled_from(FILES), CUTS)
def test_damaged_documents_are_read_or_refused(file: Path, cuts: list[tuple[float, int, str]]) -> None:
    try:
        drawing = read_drawing(mutated(file.read_bytes(), cuts), OPTIONS)
    except BadInput as error:
        assert str(error) and "\n" not in str(error)
        return
    for points in polylines(drawing):
        assert np.isfinite(points).all()


def words(text: str, separator: str | None = None) -> st.SearchStrategy[str]:
    return st.sampled_from(text.split(separator))


VALUES = words("|0|-1|5|50%|1e3|1e-9|auto|none|inherit|url(#a)|url(#b)|nonsense|3mm|2em|1,2|#a|NaN|1e999", "|")
NAMES = words(
    "x y width height rx ry r cx cy x1 y2 d points transform clip-path marker-mid marker-end stroke-dasharray stroke-width "
    "fill stroke href viewBox preserveAspectRatio pathLength display opacity font-size clipPathUnits orient refX markerWidth "
    "class id"
)
KINDS = words("g svg use symbol path rect circle ellipse line polyline polygon clipPath marker switch a defs")


@st.composite
def elements(draw: st.DrawFn, depth: int = 0) -> str:
    kind = draw(KINDS)
    given_ = {draw(NAMES): draw(VALUES) for _ in range(draw(st.integers(0, 4)))}
    attributes = "".join(f' {name}="{value}"' for name, value in given_.items())
    if draw(st.booleans()):
        attributes += draw(st.sampled_from([' id="a"', ' id="b"'])) if "id" not in given_ else ""
    if kind == "path" and "d" not in given_:
        attributes += ' d="M1 2L30 40C5 6 70 8 9 50z"'
    inner = "".join(draw(st.lists(elements(depth + 1), max_size=3))) if depth < 3 else ""
    return f"<{kind}{attributes}>{inner}</{kind}>"


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(st.lists(elements(), max_size=4))
def test_any_tree_of_elements_is_read_or_refused(parts: list[str]) -> None:
    try:
        drawing = page(
            "".join(parts), occlude=True, crop=True, hidden="all", budgets=Budgets(uses=200, markers=200, dashes=2000)
        )
    except BadInput as error:
        assert "\n" not in str(error)
        return
    for points in polylines(drawing):
        assert np.isfinite(points).all()
        assert points.min() >= -1e-6 and points.max() <= 100 + 1e-6, "the page's edge was to be kept"


COORDINATE = st.integers(0, 20).map(float) | st.floats(0, 20)
LINE = st.lists(st.tuples(COORDINATE, COORDINATE), min_size=2, max_size=8)


def piece(points: list[tuple[float, float]]) -> Piece:
    return Piece(np.array(points), np.ones(len(points), bool))


def length(pieces: list[Piece]) -> float:
    return float(sum(np.hypot(*np.diff(one.points, axis=0).T).sum() for one in pieces))


@settings(max_examples=80, deadline=None)
@example([(1.0, 0.0), (0.0, 0.0), (0.0, 3.0)], (1.192092896e-07, 0.0), 1.0, 2.0)
@given(LINE, st.tuples(COORDINATE, COORDINATE), st.floats(0.5, 15), st.floats(0.5, 15))
def test_inside_and_outside_make_the_whole(
    points: list[tuple[float, float]], corner: tuple[float, float], w: float, h: float
) -> None:
    import shapely

    line = piece(points)
    region = Region(shapely.box(corner[0], corner[1], corner[0] + w, corner[1] + h))
    inside = cut(line, region, inside=True, boundary=True)
    outside = cut(line, region, inside=False, boundary=False)
    whole = length([line])
    assert abs(length(inside) + length(outside) - whole) <= 1e-4 * (1 + whole)
    for one in inside:
        assert shapely.dwithin(region.area, shapely.points(one.points), 1e-5).all()
    # GEOS finds no distance at all from a line whose length underflows when squared.
    shape = shapely.LineString(points) if whole > 1e-9 else None
    if shape is not None:
        assert all(shapely.dwithin(shape, shapely.points(one.points), 1e-6).all() for one in inside + outside)


@settings(max_examples=60, deadline=None)
@given(LINE, st.lists(st.floats(0.3, 9), min_size=2, max_size=2), st.floats(-30, 30))
def test_dashes_and_gaps_make_the_whole(points: list[tuple[float, float]], pattern: list[float], offset: float) -> None:
    line = piece(points)
    position = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(line.points, axis=0).T))))
    total = float(position[-1])
    on = dash(line, position, np.array(pattern), offset, dots=False)
    # The gaps are the dashes of the pattern turned round, shifted by its first dash.
    off = dash(line, position, np.array(pattern[::-1]), offset - pattern[0], dots=False)
    assert abs(length(on) + length(off) - total) <= 1e-6 * (1 + total)
    for one in on:
        assert length([one]) <= pattern[0] + 1e-6
