"""Motions for tests of the encoder: uniform cubic B-splines in time, rest to rest, as the planner makes them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planning.motion.limits import Kinematics
from planning.motion.plan import Action, Draw, LayerStart, Lift, Lower, Motion, Travel

COREXY = Kinematics(np.array([[80.0, 80.0], [80.0, -80.0]]), 25000.0)
CARTESIAN = Kinematics(np.array([[80.0, 0.0], [0.0, 100.0]]), 25000.0)


def spline_motion(points_mm: NDArray[np.float64], ticks: int) -> Motion:
    """The B-spline with control points `points_mm` (k, 2), ends tripled, a knot every `ticks` ticks."""
    c = np.vstack((points_mm[:1], points_mm[:1], points_mm, points_mm[-1:], points_mm[-1:]))
    h = ticks * 40e-6
    position = (c[:-2] + 4 * c[1:-1] + c[2:]) / 6
    velocity = (c[2:] - c[:-2]) / (2 * h)
    acceleration = (c[:-2] - 2 * c[1:-1] + c[2:]) / h**2
    jerk = np.diff(acceleration, axis=0) / h
    return Motion(np.full(len(jerk), h), position[:-1], velocity[:-1], acceleration[:-1], jerk, position[-1])


def wandering(seed: int, pieces: int, ticks: int = 250, step_mm: float = 1.0, start_mm: tuple[float, float] = (0, 0)) -> Motion:
    """A random smooth walk of about `pieces` pieces, each control point at most `step_mm` from the last."""
    rng = np.random.default_rng(seed)
    headings = np.cumsum(rng.normal(0.0, 0.4, pieces))
    speeds = step_mm * rng.random(pieces)
    walk = np.cumsum(speeds[:, None] * np.column_stack((np.cos(headings), np.sin(headings))), axis=0)
    return spline_motion(np.vstack(([start_mm], np.asarray(start_mm) + walk)), ticks)


def straight(start_mm: NDArray[np.float64], end_mm: NDArray[np.float64], ramp_ticks: int, cruise_ticks: int) -> Motion:
    """Rest to rest on a line: an S-curve up, a cruise, an S-curve down."""
    t = np.array([ramp_ticks, ramp_ticks, cruise_ticks, ramp_ticks, ramp_ticks]) * 40e-6
    unit_jerk = np.array([1.0, -1.0, 0.0, -1.0, 1.0])
    p, v, a = [0.0], [0.0], [0.0]
    for h, j in zip(t, unit_jerk, strict=True):
        p.append(p[-1] + h * (v[-1] + h * (a[-1] / 2 + h * j / 6)))
        v.append(v[-1] + h * (a[-1] + h * j / 2))
        a.append(a[-1] + h * j)
    way = (end_mm - start_mm) / p[-1]
    columns = [np.asarray(values[:-1])[:, None] * way for values in (p, v, a)]
    return Motion(t, start_mm + columns[0], columns[1], columns[2], unit_jerk[:, None] * way, np.asarray(end_mm, dtype=float))


def in_parts(motion: Motion, borders: list[int]) -> list[Motion]:
    """The motion cut before these pieces: parts that go on from each other, moving."""
    ends = np.vstack((motion.position_mm, motion.end_mm))
    parts = []
    for low, high in pairwise([0, *borders, len(motion)]):
        p = slice(low, high)
        parts.append(Motion(motion.duration_s[p], motion.position_mm[p], motion.velocity_mm_s[p],
                            motion.acceleration_mm_s2[p], motion.jerk_mm_s3[p], ends[high]))  # fmt: skip
    return parts


def drawing(seed: int, strokes: int, pieces: int = 40, ticks: int = 250) -> list[Action]:
    """A plan of `strokes` random strokes with travels between, one layer."""
    rng = np.random.default_rng(seed)
    actions: list[Action] = [LayerStart(1, "all")]
    here = np.zeros(2)
    for index in range(strokes):
        start = rng.uniform(20.0, 180.0, 2)
        actions.append(Travel(straight(here, start, 5000, 20000)))
        draw = wandering(seed * 1000 + index, pieces, ticks, start_mm=(start[0], start[1]))
        actions += [Lower(0.12, index), Draw(draw, index), Lift(0.08)]
        here = draw.end_mm
    actions.append(Travel(straight(here, np.zeros(2), 5000, 20000)))
    return actions
