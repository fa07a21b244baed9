"""Stopping on the path and going on: on the path, within the limits, from and to exact states."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from planning.geometry.stroke import Stroke
from planning.motion.draw import draw_motions
from planning.motion.hold import FIT_MM, resume_on_path, stop_on_line, stop_on_path
from planning.motion.limits import Kinematics, Limits
from planning.motion.plan import Motion, still
from planning.motion.travel import straight
from tests.planning.motion_checks import assert_continuous, assert_whole_ticks, assert_within_limits, samples

COREXY = Kinematics(np.array([[80.0, 80.0], [80.0, -80.0]]), 25000.0)
SETS = [
    Limits(100, 1000, 50e3, 0.05),
    Limits(150, 2000, 100e3, 0.02),
    Limits(250, 5000, 500e3, 0.05),
    Limits(50, 500, 10e3, 0.02),
]


def path(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 9.0, 200)
    curve = np.stack((5 * t + 4 * np.sin(3 * t), 6 * np.cos(3 * t)), axis=-1)
    return np.concatenate((curve, curve[-1] + np.cumsum(rng.normal(size=(15, 2)) * 4.0, axis=0)))


def assert_on(motion: Motion, whole: Motion) -> None:
    curve = whole.sample(np.linspace(0.0, whole.total_s, int(whole.total_s * 1e5)))[0]
    assert cKDTree(curve).query(samples(motion)[0])[0].max() < FIT_MM + 0.001


@pytest.mark.parametrize("limits", SETS)
@pytest.mark.parametrize("seed", [1, 2])
def test_stop_and_resume_anywhere(limits: Limits, seed: int) -> None:
    (motion,) = draw_motions([Stroke(path(seed))], limits, COREXY)
    rng = np.random.default_rng(seed)
    for from_s in (0.0, 0.01, *rng.uniform(0.0, motion.total_s, 4), motion.total_s - 0.01, motion.total_s):
        stopping, at_s = stop_on_path(motion, float(from_s), limits)
        assert_whole_ticks(stopping)
        assert_continuous(stopping, from_rest=False)
        if len(stopping):
            begin = np.array([np.ceil(from_s / 40e-6 - 1e-6) * 40e-6])
            for mine, planned in zip(
                (stopping.position_mm, stopping.velocity_mm_s, stopping.acceleration_mm_s2), motion.sample(begin), strict=False
            ):
                assert np.abs(mine[0] - planned[0]).max() < 1e-7
            assert_within_limits(stopping, limits)
            assert_on(stopping, motion)
        assert np.abs(stopping.end_mm - motion.sample(np.array([at_s]))[0][0]).max() < 1e-9
        assert stopping.total_s <= 2.5 * limits.speed_mm_s / limits.acceleration_mm_s2 + 0.9

        going = resume_on_path(motion, at_s, limits)
        assert_whole_ticks(going)
        assert (going.end_mm == motion.end_mm).all()
        if len(going):
            assert np.abs(going.start_mm - stopping.end_mm).max() < 1e-9
            assert_continuous(going)
            assert_within_limits(going, limits)
            assert_on(going, motion)


@pytest.mark.parametrize("limits", SETS)
@pytest.mark.parametrize("length_mm", [0.5, 20.0, 250.0])
def test_a_travel_stops_on_its_line_in_the_least_time(limits: Limits, length_mm: float) -> None:
    speed, acceleration, jerk = limits.speed_mm_s, limits.acceleration_mm_s2, limits.jerk_mm_s3
    motion = straight(np.array([3.0, 4.0]), np.array([3.0, 4.0]) + length_mm * np.array([0.6, -0.8]), speed, acceleration, jerk)
    stopped = 0
    for from_s in np.linspace(0.0, motion.total_s, 60):
        stopping = stop_on_line(motion, float(from_s), limits)
        if stopping is None or not len(stopping):
            assert stopping is None or from_s == 0.0
            continue
        stopped += 1
        assert_whole_ticks(stopping)
        assert_continuous(stopping, from_rest=False)
        assert_within_limits(stopping, limits)
        begin = np.array([min(np.ceil(from_s / 40e-6 - 1e-6) * 40e-6, motion.total_s)])
        p, v, a, _ = (x[0] for x in motion.sample(begin))
        assert np.abs(stopping.start_mm - p).max() < 1e-9
        assert np.abs(stopping.velocity_mm_s[0] - v).max() < 1e-6
        assert np.abs(stopping.acceleration_mm_s2[0] - a).max() < 1e-4
        assert (motion.end_mm - stopping.end_mm) @ np.array([0.6, -0.8]) > -1e-9
        assert abs((motion.end_mm - stopping.end_mm) @ np.array([0.8, 0.6])) < 1e-9
        # From speeding up to slowing down, the slowing down, and its end.
        assert stopping.total_s <= speed / acceleration + 3.0 * acceleration / jerk + 1e-3
        assert stopping.total_s <= motion.total_s - begin[0] + 4 * 40e-6
    assert stopped > 15


@pytest.mark.parametrize("acceleration_mm_s2", [500.0, 1000.0, 5000.0])
@pytest.mark.parametrize("speed_mm_s", [1.0, 3.0, 10.0, 30.0, 100.0])
def test_a_steady_line_is_left_soon_however_slow(speed_mm_s: float, acceleration_mm_s2: float) -> None:
    """Slow lines of technical pens brake within a few pieces: no jerk may be lost to their length."""
    limits = Limits(speed_mm_s, acceleration_mm_s2, 50 * acceleration_mm_s2, 0.02)
    (motion,) = draw_motions([Stroke(np.array([[0.0, 0.0], [9.5, 3.0]]) * speed_mm_s)], limits, COREXY)  # 10 s
    rise_s = min(acceleration_mm_s2 / limits.jerk_mm_s3, (speed_mm_s / limits.jerk_mm_s3) ** 0.5)
    least_s = speed_mm_s / min(acceleration_mm_s2, rise_s * limits.jerk_mm_s3) + rise_s
    for share in (0.3, 0.5, 0.7):
        stopping, _ = stop_on_path(motion, share * motion.total_s, limits)
        assert_continuous(stopping, from_rest=False)
        assert_within_limits(stopping, limits)
        assert stopping.total_s < 4 * least_s


def test_a_time_outside_the_motion_is_refused() -> None:
    (motion,) = draw_motions([Stroke(path(1))], SETS[0], COREXY)
    with pytest.raises(ValueError, match="outside the motion"):
        stop_on_path(motion, -0.1, SETS[0])
    with pytest.raises(ValueError, match="outside the motion"):
        resume_on_path(motion, motion.total_s + 1.0, SETS[0])


def test_a_dot_stops_and_resumes_where_it_is() -> None:
    dot = still(np.array([1.0, 2.0]))
    stopping, at_s = stop_on_path(dot, 0.0, SETS[0])
    assert at_s == 0.0
    assert len(stopping) == 0
    assert len(resume_on_path(dot, 0.0, SETS[0])) == 0
