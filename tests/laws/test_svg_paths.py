"""Laws of path reading: svgpathtools agrees to 1e-9, and flattening keeps its tolerance."""

from __future__ import annotations

import math
import warnings

import numpy as np
import svgpathtools
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from plotter.svg.flatten import flatten
from plotter.svg.path_segments import ARC, CUBIC, LINE, QUADRATIC, resolve
from plotter.svg.path_tokens import parse_paths

NUMBER = st.one_of(
    st.integers(-999, 999).map(str),
    st.floats(-999, 999, allow_nan=False).map(lambda value: f"{value:.3f}"),
    st.floats(-99, 99, allow_nan=False).map(lambda value: f"{value:.4e}"),
    st.sampled_from(["0", "-0", ".5", "-.25", "+3", "1e2", "1E-3"]),
)
ARITY = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}
MM_TOLERANCE = 0.01


@st.composite
def commands(draw: st.DrawFn) -> str:
    """One command with one to three sets of arguments, glued as tightly as the grammar allows."""
    letter = draw(st.sampled_from("LHVCSQTAZlhvcsqtazMm"))
    sets = []
    for _ in range(draw(st.integers(1, 3)) if letter not in "Zz" else 0):
        values = [draw(NUMBER) for _ in range(ARITY[letter.upper()])]
        if letter in "Aa":
            values[0], values[1] = f"{draw(st.floats(0.5, 500)):.3f}", f"{draw(st.floats(0.5, 500)):.3f}"
            values[3:5] = [draw(st.sampled_from("01")), draw(st.sampled_from("01"))]
        separator = draw(st.sampled_from([" ", ",", "\n", " , "]))
        sets.append(separator.join(values))
    return letter + " ".join(sets)


PATHS = st.lists(commands(), min_size=1, max_size=12).map(lambda parts: "M1,2" + "".join(parts))


def as_complex(point: NDArray[np.float64]) -> complex:
    return complex(point[0], point[1])


@settings(max_examples=80, deadline=None)
@given(PATHS)
def test_segments_are_those_of_svgpathtools(data: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            expected = list(svgpathtools.parse_path(data))
        except AssertionError:
            assume(False)  # it refuses arcs that end where they start, which the standard leaves out
    expected = [one for one in expected if one.start != one.end or not isinstance(one, svgpathtools.Line)]
    commands_, damage = parse_paths([data])
    assert not damage
    found = resolve(commands_)
    kept = [
        i
        for i in range(len(found.kind))
        if found.kind[i] in (CUBIC, QUADRATIC) or (found.points[i, 0] != found.points[i, 3]).any() or found.kind[i] == ARC
    ]
    expected = [one for one in expected if not (isinstance(one, svgpathtools.Arc) and one.start == one.end)]
    assert len(kept) == len(expected)
    arc = -1
    for i, want in zip(kept, expected, strict=True):
        points = found.points[i]
        near = lambda a, b, size=1.0: abs(a - b) <= 1e-9 * max(1.0, size)  # noqa: E731 - read as "a is near b"
        assert near(as_complex(points[0]), want.start, abs(want.start)) and near(as_complex(points[3]), want.end, abs(want.end))
        if found.kind[i] == CUBIC:
            assert near(as_complex(points[1]), want.control1, abs(want.control1))
            assert near(as_complex(points[2]), want.control2, abs(want.control2))
        elif found.kind[i] == QUADRATIC:
            assert near(as_complex(points[1]), want.control, abs(want.control))
        elif found.kind[i] == ARC:
            arc += 1
            radius = max(abs(want.radius.real), abs(want.radius.imag))
            for t in (0.0, 0.3, 0.7, 1.0):
                theta = found.angle[arc] + t * found.sweep[arc]
                here = found.centre[arc] + math.cos(theta) * found.axis_u[arc] + math.sin(theta) * found.axis_v[arc]
                # Where a chord is nearly a diameter, the centre is a root of nearly nothing: half the digits are lost, in both.
                assert abs(as_complex(here) - want.point(t)) <= 1e-6 * max(1.0, radius)
        else:
            assert found.kind[i] == LINE


def polyline_error_mm(curve: NDArray[np.float64], polyline: NDArray[np.float64]) -> float:
    """Greatest distance from the points of `curve` to `polyline`."""
    begin, step = polyline[:-1], np.diff(polyline, axis=0)
    length2 = np.maximum((step**2).sum(axis=1), 1e-30)
    worst = 0.0
    for chunk in np.array_split(curve, max(1, len(curve) * len(begin) // 2_000_000 + 1)):
        gap = chunk[:, None] - begin[None]
        t = np.clip((gap * step).sum(axis=2) / length2, 0.0, 1.0)
        worst = max(worst, float(np.hypot(*np.moveaxis(gap - t[..., None] * step, 2, 0)).min(axis=1).max()))
    return worst


MATRIX = st.tuples(*[st.floats(-3, 3, allow_nan=False)] * 4, *[st.floats(-50, 50, allow_nan=False)] * 2)
COORDINATE = st.floats(-100, 100, allow_nan=False)


@settings(max_examples=80, deadline=None)
@given(st.lists(COORDINATE, min_size=8, max_size=8), MATRIX, st.sampled_from([0.002, 0.01, 0.1]))
def test_a_cubic_is_flattened_within_its_tolerance(values: list[float], matrix: tuple[float, ...], tolerance_mm: float) -> None:
    x0, y0, *rest = values
    data = f"M{x0!r} {y0!r}C" + " ".join(map(repr, rest))
    made = flatten(resolve(parse_paths([data])[0]), np.array([matrix]), tolerance_mm, 10**7)
    if len(made.points) < 2:
        return
    a, b, c, d, e, f = matrix
    p = np.array(values).reshape(4, 2)
    p = np.stack((a * p[:, 0] + c * p[:, 1] + e, b * p[:, 0] + d * p[:, 1] + f), axis=1)
    t = np.linspace(0, 1, 1001)[:, None]
    curve = (1 - t) ** 3 * p[0] + 3 * (1 - t) ** 2 * t * p[1] + 3 * (1 - t) * t**2 * p[2] + t**3 * p[3]
    assert polyline_error_mm(curve, made.points) <= tolerance_mm + 0.001
    assert not made.corner[1:-1].any()
    assert np.allclose(made.points[[0, -1]], p[[0, 3]], atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.floats(0.01, 400), st.floats(0.01, 400), st.floats(-180, 180), st.booleans(), MATRIX)
def test_an_arc_is_flattened_within_its_tolerance(
    rx: float, ry: float, turn: float, large: bool, matrix: tuple[float, ...]
) -> None:
    angle = math.radians(turn)
    axis = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]]) * np.array([[rx], [ry]])
    begin, end = 0.3, 0.3 + (4.5 if large else 1.7)
    point = lambda theta: np.array([math.cos(theta), math.sin(theta)]) @ axis  # noqa: E731 - the ellipse's own formula
    (x0, y0), (x1, y1) = point(begin), point(end)
    data = f"M{x0!r} {y0!r}A{rx!r} {ry!r} {turn!r} {int(large)} 1 {x1!r} {y1!r}"
    made = flatten(resolve(parse_paths([data])[0]), np.array([matrix]), MM_TOLERANCE, 10**7)
    theta = np.linspace(begin, end, 1500)
    curve = np.stack((np.cos(theta), np.sin(theta)), axis=1) @ axis
    a, b, c, d, e, f = matrix
    curve = np.stack((a * curve[:, 0] + c * curve[:, 1] + e, b * curve[:, 0] + d * curve[:, 1] + f), axis=1)
    if len(made.points) > 1:
        assert polyline_error_mm(curve, made.points) <= MM_TOLERANCE + 0.001


@settings(max_examples=40, deadline=None)
@given(st.floats(0.001, 5000), st.sampled_from([0.001, 0.01, 0.1]))
def test_a_circle_is_flattened_to_its_tolerance_and_no_finer_than_needed(radius_mm: float, tolerance_mm: float) -> None:
    arc = f"A{radius_mm!r} {radius_mm!r} 0 0 1"
    data = f"M{radius_mm!r} 0{arc} {-radius_mm!r} 0{arc} {radius_mm!r} 0Z"
    made = flatten(resolve(parse_paths([data])[0]), np.array([(1.0, 0, 0, 1, 0, 0)]), tolerance_mm, 10**7)
    on_circle = np.hypot(*made.points.T)
    middle = np.hypot(*((made.points[1:] + made.points[:-1]) / 2).T)
    assert np.abs(on_circle - radius_mm).max() <= 1e-7 * max(1.0, radius_mm)
    assert (radius_mm - middle).max() <= tolerance_mm + 0.001
    steps = len(made.points) - 1
    assert steps <= 2 * math.pi / (2 * math.acos(max(0.7, 1 - tolerance_mm / max(radius_mm, tolerance_mm)))) + 10


@settings(max_examples=80, deadline=None)
@given(st.text(alphabet="MmLlHhVvCcSsQqTtAaZz0123456789.,-+eE #x\n", max_size=60))
def test_any_text_is_read_or_named_as_damaged(text: str) -> None:
    """Nothing that is not a path gets past the fast way: what it takes undamaged is what the grammar takes."""
    commands_, damage = parse_paths(["M0 0L1 1", text, "M2 2L3 3"])
    assert set(damage) <= {1}
    segments = resolve(commands_)
    finite = np.isfinite(commands_.numbers).all()
    assert not finite or np.isfinite(segments.points).all()
    assert segments.points[0, 3].tolist() == [1, 1] and segments.points[-1, 3].tolist() == [3, 3]
