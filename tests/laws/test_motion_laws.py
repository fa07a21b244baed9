"""Every law of a Plan on random strokes: degenerate, tiny, huge, closed, reversing, dense, noisy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from planning.geometry.stroke import Layer, Stroke
from planning.motion import draw
from planning.motion.draw import draw_motions
from planning.motion.limits import Kinematics, Limits
from planning.motion.plan import Draw, Motion, Travel, joined_motion
from planning.motion.planner import MotionSettings, PenTiming, plan
from planning.motion.travel import travel
from tests.planning.motion_checks import (
    assert_continuous,
    assert_keeps_all_laws,
    assert_keeps_step_rate,
    assert_parts_follow,
    assert_whole_ticks,
    samples,
)

COREXY = Kinematics(np.array([[80.0, 80.0], [80.0, -80.0]]), 25000.0)
CARTESIAN = Kinematics(np.array([[80.0, 0.0], [0.0, 120.0]]), 20000.0)
SETS = [
    Limits(100, 1000, 50e3, 0.05),
    Limits(150, 2000, 100e3, 0.02),
    Limits(250, 5000, 500e3, 0.05),
    Limits(50, 500, 10e3, 0.02),
    Limits(150, 2000, 400e3, 0.005),
    Limits(20, 2000, 100e3, 0.2),
]
quick = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
thorough = settings(max_examples=400, deadline=None, suppress_health_check=[HealthCheck.too_slow])


@st.composite
def strokes(draw: st.DrawFn) -> NDArray[np.float64]:
    """Points (n, 2) of one stroke, of a kind that has its own way of going wrong."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(1, 30))
    size = 10.0 ** draw(st.floats(-3.5, 2.0))
    kind = draw(
        st.sampled_from(
            ["free", "two", "walk", "repeats", "closed", "back", "grid", "collinear", "curve", "noise", "still", "mixed"]
        )
    )
    p = rng.normal(size=(n, 2)) * size
    if kind == "two":
        p = rng.normal(size=(2, 2)) * size
    elif kind == "walk":
        p = np.cumsum(p, axis=0)
    elif kind == "repeats":
        p = np.repeat(p, 3, axis=0)
    elif kind == "closed":
        p = np.vstack((p, p[:1]))
    elif kind == "back":
        p = np.vstack((p, p[::-1]))
    elif kind == "grid":
        p = np.round(rng.normal(size=(n, 2)) * 3) * size
    elif kind == "collinear":
        x = rng.normal(size=(n, 1)) * size
        p = np.hstack((x, 0.3 * x))
    elif kind == "curve":
        t = np.linspace(0.0, rng.uniform(0.1, 25.0), 5 * n + 3)
        p = np.stack((size * np.cos(t), size * np.sin(t * rng.choice([1.0, 2.0, 1.3]))), axis=-1)
    elif kind == "noise":
        t = np.linspace(0.0, size, 200)
        p = np.stack((t, rng.normal(size=200) * 10.0 ** rng.uniform(-4, -1)), axis=-1)
    elif kind == "still":
        p = np.tile(rng.normal(size=2), (n, 1))
    elif kind == "mixed":
        p = p * 10.0 ** rng.uniform(-3, 0, size=(n, 1))
    return np.asarray(p + rng.normal(size=2) * 100.0, dtype=np.float64)


def check_strokes(points: list[NDArray[np.float64]], limits: Limits, kinematics: Kinematics) -> None:
    motions = draw_motions([Stroke(p) for p in points], limits, kinematics)
    assert len(motions) == len(points)
    for p, motion in zip(points, motions, strict=True):
        assert_keeps_all_laws(motion, p, limits)
        assert_keeps_step_rate(motion, kinematics)


@quick
@given(st.lists(strokes(), min_size=1, max_size=4), st.sampled_from(SETS), st.sampled_from([COREXY, CARTESIAN]))
def test_draws_keep_every_law(points: list[NDArray[np.float64]], limits: Limits, kinematics: Kinematics) -> None:
    check_strokes(points, limits, kinematics)


@pytest.mark.long
@thorough
@given(st.lists(strokes(), min_size=1, max_size=6), st.sampled_from(SETS), st.sampled_from([COREXY, CARTESIAN]))
def test_draws_keep_every_law_at_length(points: list[NDArray[np.float64]], limits: Limits, kinematics: Kinematics) -> None:
    check_strokes(points, limits, kinematics)


@quick
@given(strokes(), strokes(), st.sampled_from(SETS))
def test_a_stroke_does_not_depend_on_its_neighbours(
    first: NDArray[np.float64], second: NDArray[np.float64], limits: Limits
) -> None:
    """Batched strokes are solved in one system, but the motions are those of the strokes alone, to the tick."""
    together = draw_motions([Stroke(first), Stroke(second)], limits, COREXY)
    alone = draw_motions([Stroke(second)], limits, COREXY)
    # Rounding differs with the size of the system, and with it the round that is taken; the outcome is as good.
    assert together[1].total_s == pytest.approx(alone[0].total_s, rel=0.05, abs=2e-3)


numbers = st.floats(-300.0, 300.0).map(lambda x: round(x, 9))
points_2d = st.tuples(numbers, numbers).map(np.array)


@settings(max_examples=150, deadline=None)
@given(points_2d, points_2d, st.sampled_from(SETS), st.sampled_from([COREXY, CARTESIAN]))
def test_travel_keeps_each_motors_limits(
    start: NDArray[np.float64], end: NDArray[np.float64], limits: Limits, kin: Kinematics
) -> None:
    bounds = ((-300.0, -300.0), (300.0, 300.0))
    motion = travel(start, end, limits, kin, bounds)
    assert_whole_ticks(motion)
    assert_continuous(motion)
    assert (motion.end_mm == end).all()
    assert (motion.start_mm == start).all()
    if len(motion):
        q, v, a, j = samples(motion)
        row = np.linalg.norm(kin.steps_per_mm, axis=1)
        for value, bound in ((v, limits.speed_mm_s), (a, limits.acceleration_mm_s2), (j, limits.jerk_mm_s3)):
            assert (np.abs(kin.steps(value)) / row).max() <= bound * (1 + 1e-9)
        assert np.abs(kin.steps(v)).max() <= kin.max_step_rate * (1 + 1e-9)
        assert (np.abs(q) <= 300.0 + 1e-6).all()


@settings(max_examples=10, deadline=None)
@given(st.lists(strokes(), min_size=0, max_size=4), st.booleans())
def test_each_motion_starts_where_the_one_before_ended(points: list[NDArray[np.float64]], constant: bool) -> None:
    follow(points, constant)


@settings(max_examples=10, deadline=None)
@given(st.lists(strokes(), min_size=1, max_size=3), st.booleans())
def test_so_do_the_parts_of_a_stroke(points: list[NDArray[np.float64]], constant: bool) -> None:
    """With windows so small that most strokes come in parts."""
    small = {"LONG_VERTICES": 4, "LONG_S": 0.5, "WINDOW_VERTICES": 40, "WINDOW_S": 1.5, "LEAST_PART_S": 0.0}
    with pytest.MonkeyPatch.context() as patch:
        for name, value in small.items():
            patch.setattr(draw, name, value)
        follow(points, constant)


def follow(points: list[NDArray[np.float64]], constant: bool) -> None:
    wide = ((-2000.0, -2000.0), (2000.0, 2000.0))
    settings_ = MotionSettings(
        SETS[1], Limits(300, 3000, 200e3), COREXY, PenTiming(0.1, 0.2, 0.05), wide, constant_speed=constant
    )
    layer = Layer(1, "ink", tuple(Stroke(p) for p in points))
    at = np.zeros(2)
    drawn = []
    parts: list[Motion] = []
    for action in plan([layer], settings_, at, np.array([1.0, 2.0])):
        assert not parts or isinstance(action, Draw)
        if isinstance(action, Travel | Draw):
            assert (action.motion.start_mm == at).all()
            at = action.motion.end_mm
        if isinstance(action, Draw):
            parts.append(action.motion)
            if action.last:
                drawn.append(action.stroke)
                assert_parts_follow(parts)
                assert_keeps_all_laws(joined_motion(parts), points[action.stroke], settings_.draw)
                parts = []
    assert drawn == list(range(len(points)))
    assert (at == (1.0, 2.0)).all()
