"""Strokes that once broke something, windows over long strokes, and figures that must not get worse."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from planning.geometry.stroke import Stroke
from planning.motion import draw
from planning.motion.draw import draw_motions, draw_parts
from planning.motion.limits import Kinematics, Limits
from planning.motion.path import thinned
from planning.motion.plan import Motion, joined_motion
from planning.motion.travel import closed_form, phases, straight
from tests.planning.motion_checks import (
    assert_continuous,
    assert_keeps_all_laws,
    assert_keeps_step_rate,
    assert_parts_follow,
    assert_within_limits,
    in_order,
)

COREXY = Kinematics(np.array([[80.0, 80.0], [80.0, -80.0]]), 25000.0)
CARTESIAN = Kinematics(np.array([[80.0, 0.0], [0.0, 120.0]]), 20000.0)
L2 = Limits(150, 2000, 100e3, 0.05)
L4 = Limits(50, 500, 10e3, 0.02)
L5 = Limits(150, 2000, 400e3, 0.03)


def hilbert(order: int, step_mm: float) -> NDArray[np.float64]:
    p = np.zeros((1, 2))
    for k in range(order):
        m = 2**k
        last = np.stack((2 * m - 1 - p[:, 1], m - 1 - p[:, 0]), axis=-1)
        p = np.concatenate((p[:, ::-1], p + np.array([0, m]), p + np.array([m, m]), last))
    return p * step_mm


def random_walk(count: int, seed: int) -> NDArray[np.float64]:
    return np.cumsum(np.random.default_rng(seed).normal(size=(count, 2)), axis=0)


def spiral(vertices: int) -> NDArray[np.float64]:
    t = np.linspace(0.0, 60 * np.pi, vertices)
    return np.stack((100 + 0.3 * t * np.cos(t), 100 + 0.3 * t * np.sin(t)), axis=-1)


def shallow_corners(seed: int) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(30, 2)) * 40.0


ONCE_BROKEN = {
    # Two reversals next to each other, nothing between them in the planning grid: the profile took for ever.
    "reversals at neighbouring vertices": (np.array([[0.0, 0.0], [3.0, 0.0], [2.99, 0.0], [3.0, 0.0], [0.0, 0.0]]), L2),
    # Crossing itself: a vertex was looked for near the wrong leg and found missing.
    "random walk": (random_walk(120, 1), L2),
    # Thinning by distance alone dropped the way back along the same line.
    "back and forth on one line": (
        np.array([[89.80275918, 9.23795208], [90.03071801, 9.30633973], [90.7586487, 9.52471894], [91.38953153, 9.71398379],
                  [90.2184835, 9.36266938], [91.71348164, 9.81116882], [89.68182349, 9.20167137], [90.69852824, 9.5066828]]),
        Limits(100, 1000, 50e3, 0.05)),
    # Speed at the far end of a piece was not looked at: 0.16 % over the limit.
    "speed inside a piece": (shallow_corners(17) * (1.0, 0.5), L5),
    # Patches that could not settle in a few rounds: the stroke fell back to half speed.
    "shallow corners at low jerk": (shallow_corners(3), L4),
    # Long pieces were sampled too coarsely to be believed, and the stroke fell back to a stop at every vertex.
    "hilbert at low jerk": (hilbert(4, 2.0), L4),
    "tiny closed square": (0.012 * np.array([[0.0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]), Limits(150, 2000, 100e3, 0.005)),
    "all points the same": (np.full((5, 2), 7.25), L2),
    "two points a hair apart": (np.array([[5.0, 5.0], [5.0, 5.0 + 1e-11]]), L2),
    "tiny loop below the tolerance": (np.array([[0.0, 0.0], [0.01, 0.0], [0.01, 0.01], [0.0, 0.0]]), L2),
    "repeated points": (np.repeat(np.array([[0.0, 0], [10, 0], [10, 10]]), 4, axis=0), L2),
    "one leg of 5 m": (np.array([[0.0, 0.0], [5000.0, 10.0], [5000.0, 20.0]]), L2),
    "noise as large as the tolerance": (
        np.stack((np.arange(0, 40, 0.1), np.random.default_rng(5).normal(0, 0.02, 400)), axis=-1),
        Limits(150, 2000, 100e3, 0.02)),
}  # fmt: skip


@pytest.mark.parametrize("name", ONCE_BROKEN)
def test_strokes_that_once_broke_something(name: str) -> None:
    points, limits = ONCE_BROKEN[name]
    stops: list[int] = []
    original = draw.legs

    def counted(*args):  # type: ignore[no-untyped-def]
        stops.append(1)
        return original(*args)

    draw.legs = counted
    try:
        (motion,) = draw_motions([Stroke(np.asarray(points, dtype=np.float64))], limits, COREXY)
    finally:
        draw.legs = original
    assert_keeps_all_laws(motion, points, limits)
    assert not stops, "fell back to a stop at every vertex"


# Speed inside a piece was looked at for |v|, not for each motor: 0.03 % over what one can be stepped at.
ONCE_TOO_FAST = np.array(
    [[-112.89099188, -85.5200447], [-64.99515344, -63.46502386], [-174.43898891, -39.57771065], [-3.24449639, 14.90597101],
     [-190.07872819, -190.98331957], [-182.59127359, -69.38105538], [-340.95195804, -93.58687599],
     [-112.89099188, -85.5200447]])  # fmt: skip


def test_no_motor_is_stepped_too_fast_inside_a_piece() -> None:
    limits = Limits(250, 5000, 500e3, 0.05)
    (motion,) = draw_motions([Stroke(ONCE_TOO_FAST)], limits, CARTESIAN)
    assert_keeps_all_laws(motion, ONCE_TOO_FAST, limits)
    assert_keeps_step_rate(motion, CARTESIAN)


def test_the_check_of_order_sees_a_skipped_reversal() -> None:
    """The oracle is shown to fail: a motion along the whole line does not visit the way back."""
    motion = straight(np.zeros(2), np.array([10.0, 0.0]), 150, 2000, 100e3)
    assert in_order(np.array([[0.0, 0.0], [5.0, 0.0], [10.0, 0.0]]), motion, L2)
    assert not in_order(np.array([[0.0, 0.0], [8.0, 0.0], [3.0, 0.0], [10.0, 0.0]]), motion, L2)


def test_the_last_resort_keeps_every_law() -> None:
    points = random_walk(20, 9)
    motion = draw.legs(points, L2, COREXY)
    assert_keeps_all_laws(motion, points, L2)


def test_corner_marks_decide_where_angles_do_not() -> None:
    """A coarse polygon is a circle when its vertices are marked as smooth: faster round, and still on the polygon."""
    t = np.linspace(0.0, 2 * np.pi, 25)
    points = 1.6 * np.stack((np.cos(t), np.sin(t)), axis=-1)
    ends = np.zeros(25, dtype=np.bool_)
    ends[[0, -1]] = True
    limits = Limits(150, 2000, 100e3, 0.05)
    (smooth,) = draw_motions([Stroke(points, ends)], limits, COREXY)
    (plain,) = draw_motions([Stroke(points, np.ones(25, dtype=np.bool_))], limits, COREXY)
    assert_keeps_all_laws(smooth, points, limits)
    assert_keeps_all_laws(plain, points, limits)


@pytest.mark.parametrize(("points", "limits", "at_most_s"), [
    (np.array([[0.0, 0], [20, 0], [20, 20], [0, 20], [0, 0]]), L2, 0.86),
    (np.array([[0.0, 0], [2, 0], [2, 2], [0, 2], [0, 0]]), L2, 0.275),
    (np.stack((np.arange(60) * 2.0, (np.arange(60) % 2) * 2.2), axis=-1), L2, 4.45),
    (hilbert(4, 2.0), L2, 13.7),
])  # fmt: skip
def test_time_does_not_get_worse(points: NDArray[np.float64], limits: Limits, at_most_s: float) -> None:
    (motion,) = draw_motions([Stroke(points)], limits, COREXY)
    assert motion.total_s <= at_most_s


@pytest.fixture
def small_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("LONG_VERTICES", 50), ("WINDOW_VERTICES", 100), ("WINDOW_S", 1.5), ("LEAST_PART_S", 0.0)):
        monkeypatch.setattr(draw, name, value)


def parts_of(points: NDArray[np.float64], limits: Limits) -> list[Motion]:
    found = list(draw_parts([Stroke(points)], limits, COREXY))
    assert [last for _, _, last in found] == [False] * (len(found) - 1) + [True]
    return [motion for _, motion, _ in found]


@pytest.mark.usefixtures("small_windows")
@pytest.mark.parametrize("limits", [L2, L4, L5])
def test_windows_of_a_long_stroke_join_without_a_seam(limits: Limits) -> None:
    for points in (spiral(500)[:300], random_walk(220, 4)[:150], hilbert(3, 2.0)):
        parts = parts_of(points, limits)
        assert len(parts) > 2
        assert_parts_follow(parts)
        assert any(np.hypot(*part.velocity_mm_s[0]) > 1.0 for part in parts)
        assert_keeps_all_laws(joined_motion(parts), points, limits)


@pytest.mark.usefixtures("small_windows")
@pytest.mark.parametrize(("fails", "by_leg"), [({0}, 1), ({2}, 0), ({2, 3}, 1), ({2, 3, 5}, 1)])
def test_where_a_window_cannot_be_fitted_the_pen_stops_and_goes_on(
    fails: set[int], by_leg: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The braking that was planned is drawn; from rest the next window may be fitted, or its vertices are drawn one by one."""
    original, calls, stops = draw._fit, itertools.count(), []

    original_legs = draw.legs

    def fit(sections, *rest):  # type: ignore[no-untyped-def]
        return [None] if len(sections) and next(calls) in fails else original(sections, *rest)

    def legs(*args):  # type: ignore[no-untyped-def]
        stops.append(1)
        return original_legs(*args)

    monkeypatch.setattr(draw, "_fit", fit)
    monkeypatch.setattr(draw, "legs", legs)
    points = random_walk(220, 4)
    parts = parts_of(points, L2)
    assert_parts_follow(parts)
    assert_keeps_all_laws(joined_motion(parts), points, L2)
    assert len(stops) == by_leg


def test_a_huge_stroke_begins_before_it_is_planned(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its first part is out when a few hundred of its vertices were looked at, and each next one takes a window's work."""
    worked = 0
    original = draw.fit_sections

    def watched(sections, *rest):  # type: ignore[no-untyped-def]
        nonlocal worked
        worked += sum(len(s.points_mm) for s in sections)
        return original(sections, *rest)

    monkeypatch.setattr(draw, "fit_sections", watched)
    parts = draw_parts([Stroke(hilbert(7, 1.2))], L2, COREXY)
    _, first, last = next(parts)
    assert not last
    assert first.total_s > draw.LEAST_PART_S
    assert worked < 0.5 * draw.WINDOW_VERTICES
    for _ in range(4):
        before = worked
        next(parts)
        assert worked - before < 1.5 * draw.WINDOW_VERTICES


def test_a_stroke_of_100000_vertices_is_planned_in_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    largest = 0
    original = draw.fit_sections

    def watched(sections, *rest):  # type: ignore[no-untyped-def]
        nonlocal largest
        largest = max(largest, sum(len(s.points_mm) for s in sections))
        return original(sections, *rest)

    monkeypatch.setattr(draw, "fit_sections", watched)
    points = spiral(100_000)
    (motion,) = draw_motions([Stroke(points)], L2, COREXY)
    assert largest <= 1.25 * draw.WINDOW_VERTICES + 1000
    assert_continuous(motion)
    assert_within_limits(motion, L2)
    q = motion.sample(np.linspace(0.0, motion.total_s, 5000))[0]
    # Radius and angle of an Archimedean spiral go together: no search needed to see that the pen is on it.
    offset = q - 100.0
    radius = np.hypot(*offset.T)
    angle = np.unwrap(np.arctan2(offset[:, 1], offset[:, 0]))
    outside = radius > 3.0
    turns = np.round((radius / 0.3 - angle)[outside] / (2 * np.pi))
    assert np.ptp(turns) == 0
    assert np.abs(radius[outside] - 0.3 * (angle[outside] + 2 * np.pi * turns)).max() <= L2.tolerance_mm + 0.001
    assert (motion.end_mm == points[-1]).all()


def test_thinning_keeps_ends_and_order() -> None:
    points = np.array([[0.0, 0], [5, 0], [10, 0], [10, 0], [5, 0], [7, 0.0], [0, 0]])
    kept = points[thinned(points, 0.001)]
    assert kept[:, 0].tolist() == [0, 10, 5, 7, 0]
    assert thinned(np.array([[0.0, 0], [1, 0]]), 0.001).tolist() == [0, 1]


@pytest.mark.parametrize("seed", range(3))
def test_profiles_agree_with_the_closed_form_to_a_tick_per_phase(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(300):
        d, v, a, j = 10.0 ** rng.uniform((-6, 0, 1, 2), (3, 3, 4, 6))
        found = phases(d, v, a, j)
        tj, ta, tv = closed_form(d, v, a, j)
        assert -1e-9 <= found.ticks * 40e-6 - (4 * tj + 2 * ta + tv) < 8 * 40e-6
        speed, acceleration, jerk = found.peaks(d)
        assert speed <= v * (1 + 1e-9)
        assert acceleration <= a * (1 + 1e-9)
        assert jerk <= j * (1 + 1e-9)


def test_a_distance_at_the_border_of_two_cases_has_a_profile() -> None:
    """ruckig raises for 2 A^3 / J^2 exactly: 0.8 mm at 1000 mm/s2 and 50000 mm/s3."""
    assert phases(0.8000000000000114, 100, 1000, 50e3).jerk == 500
    (motion,) = draw_motions([Stroke(np.array([[0.0, 0.0], [0.8000000000000114, 0.0]]))], Limits(100, 1000, 50e3), COREXY)
    assert motion.total_s == pytest.approx(0.08, abs=2e-4)
