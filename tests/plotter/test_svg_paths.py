"""Path grammar, what damaged paths draw, zero-length subpaths, order, direction and corner marks."""

from __future__ import annotations

import numpy as np
import pytest

from plotter.svg.path_segments import resolve
from plotter.svg.path_tokens import parse_paths, repair
from tests.plotter.svg_help import marks, page, polylines, rounded


@pytest.mark.parametrize(
    ("data", "points"),
    [
        ("M0 0 10 10 20 0", [[0, 0], [10, 10], [20, 0]]),
        ("m5 5 10 0 0 10", [[5, 5], [15, 5], [15, 15]]),
        ("M10-20.5.5.5", [[10, -20.5], [0.5, 0.5]]),
        ("M0,0L10,0h5v5H0V1z", [[0, 0], [10, 0], [15, 0], [15, 5], [0, 5], [0, 1], [0, 0]]),
        ("M1e1 1E+1L2e-1.5", [[10, 10], [0.2, 0.5]]),
        ("M.5.5.6.7-1-2+3+4", [[0.5, 0.5], [0.6, 0.7], [-1, -2], [3, 4]]),
        ("\n M\t1 , 2\r L 3 4 , ", [[1, 2], [3, 4]]),
        ("M0 0L1 1Zl2 0", [[0, 0], [1, 1], [0, 0]]),
    ],
)
def test_grammar(data: str, points: list[list[float]]) -> None:
    drawing = page(f'<path d="{data}"/>')
    assert rounded(drawing)[:1] == ([points] if len(points) > 1 else [])
    assert not drawing.warnings


def test_a_close_starts_anew_where_the_subpath_began() -> None:
    assert rounded(page('<path d="M5 5h10v10zl-5 0zm1 1h1"/>')) == [
        [[5, 5], [15, 5], [15, 15], [5, 5]],
        [[5, 5], [0, 5], [5, 5]],
        [[6, 6], [7, 6]],
    ]


@pytest.mark.parametrize("packed", ["a25,25 0 1125,25", "a25,25 0 1 125,25", "a25 25,0,1,1,25 25", "a25,25 0 1 1+25.0e0,25"])
def test_packed_arc_flags(packed: str) -> None:
    want = polylines(page('<path d="M0 0a25 25 0 1 1 25 25"/>'))[0]
    assert np.allclose(polylines(page(f'<path d="M0 0{packed}"/>'))[0], want, atol=1e-12)


@pytest.mark.parametrize(
    ("data", "points"),
    [
        ("M0 0L10 10L20#5", [[0, 0], [10, 10]]),
        ("M0 0L10 10 20", [[0, 0], [10, 10]]),
        ("M0 0C1 1 2 2", []),
        ("L5 5", []),
        ("M0 0L10 10,,20 20", [[0, 0], [10, 10]]),
        ("M0 0L10 10L,20 20", [[0, 0], [10, 10]]),
        ("M0 0L10 10x5", [[0, 0], [10, 10]]),
        ("M0 0L10 10a5 5 0 2 0 1 1", [[0, 0], [10, 10]]),
        ("M0 0L5 5L1. 2", [[0, 0], [5, 5]]),
        ("M0 0L5 5L1e 2", [[0, 0], [5, 5]]),
        ("M0 0L5 5L- 2", [[0, 0], [5, 5]]),
        ("M0 0L5 5Z3 4", [[0, 0], [5, 5], [0, 0]]),
        ("5 5M0 0L1 1", []),
        ("M0 0LNaN 5", []),
    ],
)
def test_a_damaged_path_draws_up_to_its_damage_and_is_named(data: str, points: list[list[float]]) -> None:
    drawing = page(f'<path d="M50 50L51 51"/><path id="broken" d="{data}"/><path d="M60 60L61 61"/>')
    middle = [one for one in rounded(drawing) if one[0][0] < 50]
    assert middle == ([points] if points else [])
    assert len(rounded(drawing)) == 2 + bool(points)
    assert any("'broken'" in warning for warning in drawing.warnings)


def test_a_repaired_path_needs_no_repair() -> None:
    for data in ("M0 0L1 1 2", "M0,0,,1", "M1 1a1,1 0 0115", "M0 0l1e5.5"):
        clean, _ = repair(data)
        commands, damage = parse_paths([clean])
        assert not damage
        assert np.isfinite(commands.numbers).all()


def test_many_paths_are_read_as_one_by_one() -> None:
    texts = ["M0 0l1 1", "", "bad", "m3 3h1zl1 1", "M0 0q1 1 2 0t2 0t1 1", "M1 1L2", "M0 0a5,5 0 015 5", "M5 5", "   "]
    together = resolve(parse_paths(texts)[0])
    apart = [resolve(parse_paths([text])[0]) for text in texts]
    assert np.allclose(together.points, np.concatenate([one.points for one in apart]))
    assert together.path.tolist() == [i for i, one in enumerate(apart) for _ in one.path]


def test_long_runs_of_implicit_arcs_are_checked_across_pieces() -> None:
    """Longer than a piece, without a command between: packed flags anywhere must still be seen."""
    plain = "5 5 0 0 1 1 1 " * 200_000
    assert len(resolve(parse_paths(["M0 0a" + plain])[0]).kind) == 200_000
    packed = plain[: 14 * 190_000] + "5 5 0 011 1 " + "5 5 0 01 1 1 " * 20
    commands, damage = parse_paths(["M0 0a" + packed])
    assert not damage
    assert len(commands.code) == 1 + 190_000 + 21


def test_long_relative_paths_do_not_drift() -> None:
    steps = "l0.1 0.1" * 200_000
    end = resolve(parse_paths(["M0 0" + steps])[0]).points[-1, 3]
    assert np.abs(end - 20_000).max() < 1e-9


def test_dots_are_drawn_by_round_and_square_caps_only() -> None:
    for cap, count in (("round", 2), ("square", 2), ("butt", 0)):
        drawing = page(f'<path stroke-linecap="{cap}" d="M5 5zzz M7 7h0 M9 9"/>')
        assert [len(one) for one in polylines(drawing)] == [1] * count


def test_shapes_start_and_turn_as_the_standard_says() -> None:
    assert rounded(page('<rect x="1" y="2" width="3" height="4"/>')) == [[[1, 2], [4, 2], [4, 6], [1, 6], [1, 2]]]
    circle = polylines(page('<circle cx="50" cy="50" r="10"/>'))[0]
    assert circle[0].tolist() == [60, 50] and (circle[0] == circle[-1]).all()
    assert circle[1][1] > 50, "clockwise on the page"
    assert rounded(page('<line x1="1" y1="2" x2="3" y2="4"/>')) == [[[1, 2], [3, 4]]]
    assert rounded(page('<polyline points="1,2 3,4 5"/>')) == [[[1, 2], [3, 4]]]
    assert rounded(page('<polygon points="0,0 4,0 4,4"/>')) == [[[0, 0], [4, 0], [4, 4], [0, 0]]]


@pytest.mark.parametrize(
    ("attributes", "rx", "ry"),
    [
        ('rx="5"', 5, 5),
        ('ry="2"', 2, 2),
        ('rx="50" ry="3"', 10, 3),
        ('rx="5" ry="-1"', 5, 5),
        ('rx="10%"', 10, 10),
        ('rx="0"', 0, 0),
    ],
)
def test_corner_radii(attributes: str, rx: float, ry: float) -> None:
    points = polylines(page(f'<rect x="10" y="10" width="20" height="40" {attributes}/>'))[0]
    assert np.allclose(points[0], [10 + rx, 10])
    assert np.isclose(points[:, 1][np.isclose(points[:, 0], 30)].min(), 10 + ry)
    assert np.allclose(points.max(axis=0), [30, 50])


def test_document_order_is_kept_across_kinds_of_shapes() -> None:
    body = "".join(
        f'<path d="M{i} 0h1"/><rect x="{i}" y="1" width="1" height="1"/>'
        f'<circle cx="{i}" cy="5" r="1"/><polyline points="{i},9 {i},8"/>'
        for i in range(10)
    )
    starts = [one[0] for one in rounded(page(body))]
    assert starts == [start for i in range(10) for start in ([i, 0], [i, 1], [i + 1, 5], [i, 9])]


def test_corners_are_marked_and_smooth_joins_are_not() -> None:
    (square,) = marks(page('<path d="M0 0h10v10h-10z"/>'))
    assert square == [True] * 5
    (curve,) = marks(page('<path d="M0 0C0 10 10 10 10 0S20-10 20 0"/>'))
    assert curve[0] and curve[-1] and not any(curve[1:-1])
    (cusp,) = marks(page('<path d="M0 0C0 10 10 10 10 0C10 10 20 10 20 0"/>'))
    points = polylines(page('<path d="M0 0C0 10 10 10 10 0C10 10 20 10 20 0"/>'))[0]
    assert [tuple(points[i]) for i in np.flatnonzero(cusp)] == [(0, 0), (10, 0), (20, 0)]
    (slot,) = marks(page('<rect x="10" y="10" width="50" height="20" rx="8"/>'))
    assert sum(slot) == 2
    (circle,) = marks(page('<circle cx="50" cy="50" r="10"/>'))
    assert sum(circle) == 2


def test_a_rounded_close_adds_no_tiny_segment() -> None:
    (points,) = polylines(page('<path d="M0 0L10 0L10 10L1e-7 1e-7Z"/>'))
    assert len(points) == 4 and (points[0] == points[-1]).all()


def test_tolerance_and_smoothness_of_a_rotated_ellipse() -> None:
    body = '<ellipse rx="40" ry="5" transform="translate(50 50) rotate(30) skewX(20) scale(1.1 0.7)"/>'
    (points,) = polylines(page(body, tolerance_mm=0.02))
    (mask,) = marks(page(body, tolerance_mm=0.02))
    assert sum(mask) == 2
    assert 40 < len(points) < 400
