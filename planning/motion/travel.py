"""Straight moves and pen-up travel: from rest to rest in the least time that speed, acceleration and jerk allow.

ruckig gives the phases (jerk up, steady, down; cruise; and back). Every phase is rounded up to whole ticks, and the jerk is
lowered to what still covers the distance: with phases tj, ta, tj, tv, tj, ta, tj

    distance = j tj (tj + ta) (2 tj + ta + tv)      speed = j tj (tj + ta)      acceleration = j tj

so that longer phases lower all three, and the move starts and ends at rest exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ruckig import InputParameter, Result, Ruckig, RuckigError, Trajectory

from planning.errors import ImpossiblePlan
from planning.motion.limits import Kinematics, Limits
from planning.motion.path import Array, Ints
from planning.motion.plan import TICK_S, Motion, still

Bounds = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True, slots=True)
class Phases:
    """A rest-to-rest profile in whole ticks: jerk (4 times), steady acceleration (twice), cruise."""

    jerk: int
    steady: int
    cruise: int

    @property
    def ticks(self) -> int:
        return 4 * self.jerk + 2 * self.steady + self.cruise

    def unit_jerk(self) -> float:
        """The jerk that covers one unit of distance, per s^3."""
        tj, ta, tv = self.jerk * TICK_S, self.steady * TICK_S, self.cruise * TICK_S
        return 1.0 / (tj * (tj + ta) * (2.0 * tj + ta + tv))

    def peaks(self, distance: float) -> tuple[float, float, float]:
        """Greatest speed, acceleration and jerk when it covers `distance`."""
        j = distance * self.unit_jerk()
        a = j * self.jerk * TICK_S
        return a * (self.jerk + self.steady) * TICK_S, a, j

    def bounds_ticks(self) -> Ints:
        """When each of the 7 phases ends, in ticks."""
        tj, ta, tv = self.jerk, self.steady, self.cruise
        return np.cumsum(np.array([tj, ta, tj, tv, tj, ta, tj], dtype=np.int64))

    def states(self, at_ticks: Ints) -> tuple[Array, Array, Array]:
        """Share of the way, its speed and acceleration, at whole ticks (m,). Exact by symmetry: the second half mirrors the

        first.
        """
        total = self.ticks
        mirrored = at_ticks * 2 > total
        t = np.where(mirrored, total - at_ticks, at_ticks) * TICK_S
        j, tj, ta = self.unit_jerk(), self.jerk * TICK_S, self.steady * TICK_S
        first, second, third = np.minimum(t, tj), np.clip(t - tj, 0.0, ta), np.clip(t - tj - ta, 0.0, tj)
        cruise = np.maximum(t - 2.0 * tj - ta, 0.0)
        a = j * first - j * third
        v1 = j * first**2 / 2.0
        v2 = v1 + j * first * second
        v = v2 + j * first * third - j * third**2 / 2.0
        p = j * first**3 / 6.0 + v1 * second + j * first * second**2 / 2.0
        p += v2 * third + j * first * third**2 / 2.0 - j * third**3 / 6.0 + v * cruise
        return np.where(mirrored, 1.0 - p, p), v, np.where(mirrored, -a, a)


class _OneAxis:
    """ruckig's objects for one axis, made once: they cost more than a calculation."""

    def __init__(self) -> None:
        self.otg = Ruckig(1)
        self.request = InputParameter(1)
        self.answer = Trajectory(1)


_AXIS = _OneAxis()


def phases(distance: float, speed: float, acceleration: float, jerk: float) -> Phases:
    """The fastest rest-to-rest profile over `distance` > 0, phases rounded up to whole ticks.

    Raises ImpossiblePlan when the answer breaks a limit.
    """
    request = _AXIS.request
    request.current_position, request.target_position = [0.0], [float(distance)]
    request.max_velocity, request.max_acceleration, request.max_jerk = [speed], [acceleration], [jerk]
    try:
        known = _AXIS.otg.calculate(request, _AXIS.answer) in (Result.Working, Result.Finished)
    except RuckigError:
        known = False
    t = list(_AXIS.answer.profiles[0][0].t) if known else [0.0] * 7
    tj, ta, tv = closed_form(distance, speed, acceleration, jerk)
    symmetric = [tj, ta, tj, tv, tj, ta, tj]
    if max(abs(x - y) for x, y in zip(t, symmetric, strict=True)) > 0.25 * TICK_S:
        # ruckig finds nothing at the very border of two cases (a distance of exactly 2 A^3 / J^2) or for tiny distances, and
        # may give the same profile in phases that are not symmetric.
        t = symmetric
    found = Phases(max(1, _up(t[0])), _up(t[1]), _up(t[3]))
    v, a, j = found.peaks(distance)
    if v > speed * (1 + 1e-9) or a > acceleration * (1 + 1e-9) or j > jerk * (1 + 1e-9):
        raise ImpossiblePlan(
            f"the profile over {distance:.6g} mm reaches {v:.6g} mm/s, {a:.6g} mm/s2, {j:.6g} mm/s3: above its limits"
        )
    return found


def closed_form(distance: float, speed: float, acceleration: float, jerk: float) -> tuple[float, float, float]:
    """Seconds of jerk, steady acceleration and cruise of the fastest rest-to-rest profile."""
    tj, ta = (acceleration / jerk, speed / acceleration - acceleration / jerk)
    if ta < 0.0:
        tj, ta = float(np.sqrt(speed / jerk)), 0.0
    ramps = speed * (2.0 * tj + ta)
    if distance >= ramps:
        return tj, ta, (distance - ramps) / speed
    if distance <= 2.0 * acceleration**3 / jerk**2:
        return float(np.cbrt(distance / (2.0 * jerk))), 0.0, 0.0
    tj = acceleration / jerk
    return tj, max(0.0, (float(np.sqrt(tj * tj + 4.0 * distance / acceleration)) - 3.0 * tj) / 2.0), 0.0


def _up(seconds: float) -> int:
    return int(np.ceil(seconds / TICK_S - 1e-6))


def straight(start_mm: Array, end_mm: Array, speed: float, acceleration: float, jerk: float) -> Motion:
    """The straight line from rest to rest, limits along the line. No pieces when start and end are the same."""
    way = end_mm - start_mm
    distance = float(np.hypot(*way))
    if distance == 0.0:
        return still(end_mm)
    # A hair below the limits: the arithmetic of the pieces rounds too.
    found = phases(distance, speed * (1 - 1e-7), acceleration * (1 - 1e-7), jerk * (1 - 1e-7))
    return _joined(start_mm, end_mm, [(way, found)])


def _joined(start_mm: Array, end_mm: Array, parts: list[tuple[Array, Phases]]) -> Motion:
    """Profiles that run at the same time, each along its own way (2,), as one motion."""
    ends = np.unique(np.concatenate([p.bounds_ticks() for _, p in parts]))
    at = np.unique(np.concatenate((np.zeros(1, dtype=np.int64), ends)))
    position = np.tile(start_mm, (len(at), 1))
    velocity, acceleration = np.zeros((len(at), 2)), np.zeros((len(at), 2))
    for way, profile in parts:
        p, v, a = profile.states(at)
        position += p[:, None] * way
        velocity += v[:, None] * way
        acceleration += a[:, None] * way
    duration = np.diff(at) * TICK_S
    jerk = np.diff(acceleration, axis=0) / duration[:, None]
    return Motion(duration, position[:-1], velocity[:-1], acceleration[:-1], jerk, np.array(end_mm, dtype=np.float64))


def travel(start_mm: Array, end_mm: Array, limits: Limits, kinematics: Kinematics, bounds_mm: Bounds) -> Motion:
    """Pen-up travel in the least time for motors that each keep `limits` (mm of belt: steps over the norm of the motor's row).

    A motor that would be early cruises longer. Straight where both can share one profile, which is always so when both have
    the same limits; otherwise curved, unless that would leave `bounds_mm`.
    """
    row = np.linalg.norm(kinematics.steps_per_mm, axis=1)
    way = end_mm - start_mm
    belt = np.abs(kinematics.steps_per_mm @ way) / row
    if not belt.any():
        return still(end_mm)
    speeds = np.minimum(limits.speed_mm_s, kinematics.max_step_rate / row) * (1 - 1e-7)
    accel, jerk = limits.acceleration_mm_s2 * (1 - 1e-7), limits.jerk_mm_s3 * (1 - 1e-7)
    own = [phases(float(b), float(v), accel, jerk) if b > 1e-9 else None for b, v in zip(belt, speeds, strict=True)]
    slowest = max((p for p in own if p is not None), key=lambda p: p.ticks, default=None)
    if slowest is None:
        return straight(start_mm, end_mm, float(speeds.min()), accel, jerk)
    if all(_keeps(slowest, float(b), float(v), accel, jerk) for b, v in zip(belt, speeds, strict=True)):
        return _joined(start_mm, end_mm, [(way, slowest)])
    steps = kinematics.steps_per_mm @ way
    back = np.linalg.inv(kinematics.steps_per_mm)
    parts = []
    for i, profile in enumerate(own):
        mine = profile or slowest
        late = Phases(mine.jerk, mine.steady, mine.cruise + slowest.ticks - mine.ticks)
        parts.append((back[:, i] * steps[i], late))
    curved = _joined(start_mm, end_mm, parts)
    if _inside(curved, bounds_mm):
        return curved
    along = belt / np.hypot(*way)
    line_speed = float((speeds / np.maximum(along, 1e-12)).min())
    return straight(start_mm, end_mm, line_speed, float(accel / along.max()), float(jerk / along.max()))


def _keeps(profile: Phases, distance: float, speed: float, acceleration: float, jerk: float) -> bool:
    v, a, j = profile.peaks(distance)
    return v <= speed and a <= acceleration and j <= jerk


def _inside(motion: Motion, bounds_mm: Bounds) -> bool:
    """True when every piece's Bezier hull, and so the piece itself, is inside."""
    t = motion.duration_s[:, None]
    p, v, a = motion.position_mm, motion.velocity_mm_s, motion.acceleration_mm_s2
    hull = np.concatenate((p, p + v * t / 3.0, p + v * t * 2.0 / 3.0 + a * t * t / 6.0, motion.ends()[0]))
    (x0, y0), (x1, y1) = bounds_mm
    margin = 1e-9
    return bool((hull >= (x0 - margin, y0 - margin)).all() and (hull <= (x1 + margin, y1 + margin)).all())
