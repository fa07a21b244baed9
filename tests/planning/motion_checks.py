"""The laws of a Plan, checked on a motion by dense sampling: written apart from the planner, so that the two can disagree."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planning.motion.limits import Kinematics, Limits
from planning.motion.plan import TICK_S, Motion, joined_motion

Points = NDArray[np.float64]


def assert_whole_ticks(motion: Motion) -> None:
    ticks = motion.duration_s / TICK_S
    assert np.abs(ticks - np.rint(ticks)).max(initial=0.0) < 1e-6


def assert_continuous(motion: Motion, from_rest: bool = True) -> None:
    """Position, velocity and acceleration run on from piece to piece, and are those of rest at the end (and at the start)."""
    if not len(motion):
        return
    position, velocity, acceleration = motion.ends()
    after = np.vstack((motion.position_mm[1:], motion.end_mm))
    rest = np.zeros((1, 2))
    assert np.abs(position - after).max() < 1e-9
    assert np.abs(velocity - np.vstack((motion.velocity_mm_s[1:], rest))).max() < 1e-7
    assert np.abs(acceleration - np.vstack((motion.acceleration_mm_s2[1:], rest))).max() < 1e-5
    if from_rest:
        assert not motion.velocity_mm_s[0].any()
        assert not motion.acceleration_mm_s2[0].any()


def assert_parts_follow(parts: Sequence[Motion]) -> None:
    """Each part starts with exactly the state with which the one before ended; the first and the last are at rest outside."""
    for before, after in pairwise(parts):
        position, velocity, acceleration = (x[-1] for x in before.ends())
        assert (before.end_mm == after.start_mm).all()
        assert np.abs(position - after.position_mm[0]).max() < 1e-9
        assert np.abs(velocity - after.velocity_mm_s[0]).max() < 1e-7
        assert np.abs(acceleration - after.acceleration_mm_s2[0]).max() < 1e-5
    for part in parts:
        assert len(part) or len(parts) == 1
    assert_continuous(joined_motion(parts))


def samples(motion: Motion, step_s: float = 0.0005) -> tuple[Points, Points, Points, Points]:
    count = max(200, int(np.ceil(motion.total_s / step_s)) + 1)
    return motion.sample(np.linspace(0.0, motion.total_s, count))


def assert_within_limits(motion: Motion, limits: Limits) -> None:
    _, v, a, j = samples(motion)
    assert np.hypot(*v.T).max() <= limits.speed_mm_s * (1 + 1e-9)
    assert np.hypot(*a.T).max() <= limits.acceleration_mm_s2 * (1 + 1e-9)
    assert np.hypot(*j.T).max() <= limits.jerk_mm_s3 * (1 + 1e-9)


def assert_keeps_step_rate(motion: Motion, kinematics: Kinematics) -> None:
    """Every motor's rate at the ends of each piece and where it turns inside: a quadratic has no other extremes."""
    if not len(motion):
        return
    v, a, j = (kinematics.steps(x) for x in (motion.velocity_mm_s, motion.acceleration_mm_s2, motion.jerk_mm_s3))
    h = motion.duration_s[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = np.where(j == 0.0, 0.0, np.clip(-a / j, 0.0, h))
    for t in (np.zeros_like(h), turn, h):
        assert np.abs(v + t * (a + t * j / 2)).max() <= kinematics.max_step_rate * (1 + 1e-9)


def farthest(at: Points, line: Points) -> float:
    """The greatest distance of any of `at` (m, 2) from the polyline `line` (n, 2), by looking at every segment."""
    if len(line) == 1:
        return float(np.hypot(*(at - line[0]).T).max())
    start, chord = line[:-1], np.diff(line, axis=0)
    square = np.maximum((chord**2).sum(axis=1), 1e-300)
    worst = 0.0
    for some in np.array_split(at, min(len(at), max(1, len(at) * len(chord) // 2_000_000))):
        offset = some[:, None] - start
        share = np.clip((offset * chord).sum(axis=2) / square, 0.0, 1.0)
        rest = offset - share[..., None] * chord
        worst = max(worst, float(np.sqrt((rest**2).sum(axis=2).min(axis=1)).max()))
    return worst


def assert_draws(motion: Motion, points: Points, limits: Limits) -> None:
    """Starts and ends on the stroke's ends exactly, stays within the tolerance of it, and leaves none of its vertices out."""
    assert (motion.start_mm == points[0]).all() or not len(motion)
    assert (motion.end_mm == points[-1]).all()
    if not len(motion):
        assert farthest(points, points[-1:]) <= limits.tolerance_mm
        return
    q = samples(motion, max(0.0005, motion.total_s / 50_000))[0]
    assert farthest(q, points) <= limits.tolerance_mm
    step_s = max(0.0002, motion.total_s / 100_000)
    fine = samples(motion, step_s)[0]
    # Chords of the samples cut bends by |a| dt^2 / 8.
    assert farthest(points, fine) <= limits.tolerance_mm + limits.acceleration_mm_s2 * step_s**2 / 8.0 + 1e-9
    assert in_order(points, motion, limits)


def in_order(points: Points, motion: Motion, limits: Limits) -> bool:
    """True when the vertices can be visited one after the other in time, each within the tolerance: nothing is cut short."""
    count = max(400, int(motion.total_s / 0.0004))
    q = motion.sample(np.linspace(0.0, motion.total_s, count))[0]
    reach = limits.tolerance_mm + limits.speed_mm_s * motion.total_s / count
    at = 0
    for p in points:
        near = np.flatnonzero(np.hypot(*(q[at:] - p).T) <= reach)
        if not len(near):
            return False
        at += int(near[0])
    return True


def assert_keeps_all_laws(motion: Motion, points: Points, limits: Limits) -> None:
    assert_whole_ticks(motion)
    assert_continuous(motion)
    if len(motion):
        assert_within_limits(motion, limits)
    assert_draws(motion, points, limits)
