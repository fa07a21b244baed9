"""The Plan: what the pen will do, independent of any board.

A Plan is a sequence of actions. Travel and draw carry a Motion: x(t), y(t) as piecewise cubics in machine millimetres.
Clock: plan time, seconds since the motion's own start. Positions are planned positions; nothing here knows a queue.

A long stroke is drawn in several Draws, its parts, so that the first can be drawn while the rest is planned.

Laws (property tests in tests/laws):
- inside a motion, position, velocity and acceleration are continuous; it starts and ends at rest;
- but parts of one stroke follow each other directly, moving: each starts with exactly the position, velocity and acceleration
  with which the one before it ended, the first from rest, and the one that says `last` ends at rest;
- each motion starts exactly where the one before it ended;
- speed, acceleration and jerk stay within their limits at every instant;
- a draw stays within the path tolerance of its stroke, visits all of it, and starts and ends on its ends.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planning.motion.clearance import PenHeight

Array = NDArray[np.float64]

# Pieces last a whole number of these, so that no board has to round them: 40 us, the EiBotBoard's step interrupt.
TICK_S = 40e-6


@dataclass(frozen=True, eq=False, slots=True)
class Motion:
    """A piecewise cubic, from rest to rest unless it is a part of one. n pieces, each with its duration and state at its start.

    `duration_s` (n,), whole multiples of TICK_S; `position_mm`, `velocity_mm_s`, `acceleration_mm_s2`, `jerk_mm_s3` (n, 2);
    `end_mm` (2,), the position after the last piece. n = 0 is a motion that stays where it is (a dot).

    Raises ValueError for shapes that do not fit, a duration that is not positive, or a value that is not finite.
    """

    duration_s: Array
    position_mm: Array
    velocity_mm_s: Array
    acceleration_mm_s2: Array
    jerk_mm_s3: Array
    end_mm: Array

    def __post_init__(self) -> None:
        n = len(self.duration_s)
        for name in ("position_mm", "velocity_mm_s", "acceleration_mm_s2", "jerk_mm_s3"):
            value = getattr(self, name)
            if value.shape != (n, 2):
                raise ValueError(f"motion: {name} is {value.shape}, expected {(n, 2)}")
            if not np.isfinite(value).all():
                raise ValueError(f"motion: {name} is not finite")
        if self.end_mm.shape != (2,) or not np.isfinite(self.end_mm).all():
            raise ValueError(f"motion: end_mm must be two finite numbers, not {self.end_mm}")
        if n and not (np.isfinite(self.duration_s).all() and (self.duration_s > 0).all()):
            raise ValueError("motion: every duration must be positive and finite")

    def __len__(self) -> int:
        return len(self.duration_s)

    @property
    def start_mm(self) -> Array:
        return self.position_mm[0] if len(self) else self.end_mm

    @property
    def total_s(self) -> float:
        return float(self.duration_s.sum())

    def ends(self) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration at the end of each piece, each (n, 2), by the piece's own cubic."""
        t = self.duration_s[:, None]
        velocity = self.velocity_mm_s + t * (self.acceleration_mm_s2 + t * self.jerk_mm_s3 / 2)
        position = self.position_mm + t * (self.velocity_mm_s + t * (self.acceleration_mm_s2 / 2 + t * self.jerk_mm_s3 / 6))
        return position, velocity, self.acceleration_mm_s2 + t * self.jerk_mm_s3

    def split(self, at_s: float) -> tuple[Motion, Motion]:
        """The motion up to plan time `at_s`, rounded to a tick, and from there on; the inner border may be moving."""
        ticks = np.rint(self.duration_s / TICK_S).astype(np.int64)
        ends = np.cumsum(ticks)
        at = round(at_s / TICK_S)
        i = int(np.searchsorted(ends, at, side="right"))
        if i == len(self):
            return self, still(self.end_mm)
        inside = at - int(ends[i] - ticks[i])
        # Not by `sample`: rounding could take a border's state from the piece before.
        t, p, v = inside * TICK_S, self.position_mm[i], self.velocity_mm_s[i]
        a, j = self.acceleration_mm_s2[i], self.jerk_mm_s3[i]
        p, v, a = p + t * (v + t * (a / 2 + t * j / 6)), v + t * (a + t * j / 2), a + t * j
        head = i + (inside > 0)
        first = Motion(
            np.append(self.duration_s[:i], [inside * TICK_S] * (inside > 0)),
            self.position_mm[:head],
            self.velocity_mm_s[:head],
            self.acceleration_mm_s2[:head],
            self.jerk_mm_s3[:head],
            p,
        )
        rest = Motion(
            np.append((ticks[i] - inside) * TICK_S, self.duration_s[i + 1 :]),
            np.vstack((p, self.position_mm[i + 1 :])),
            np.vstack((v, self.velocity_mm_s[i + 1 :])),
            np.vstack((a, self.acceleration_mm_s2[i + 1 :])),
            np.vstack((j, self.jerk_mm_s3[i + 1 :])),
            self.end_mm,
        )
        return first, rest

    def sample(self, t_s: Array) -> tuple[Array, Array, Array, Array]:
        """Position, velocity, acceleration and jerk at plan times `t_s` (m,), each (m, 2). Times are clipped to the motion."""
        if not len(self):
            zeros = np.zeros((len(t_s), 2))
            return np.broadcast_to(self.end_mm, zeros.shape).copy(), zeros, zeros.copy(), zeros.copy()
        starts = np.concatenate(([0.0], np.cumsum(self.duration_s)))
        clipped = np.clip(t_s, 0.0, starts[-1])
        i = np.clip(np.searchsorted(starts, clipped, side="right") - 1, 0, len(self) - 1)
        t = (clipped - starts[i])[:, None]
        p, v, a, j = self.position_mm[i], self.velocity_mm_s[i], self.acceleration_mm_s2[i], self.jerk_mm_s3[i]
        return p + t * (v + t * (a / 2 + t * j / 6)), v + t * (a + t * j / 2), a + t * j, j


def still(at_mm: Array) -> Motion:
    """The motion of a dot: no pieces, at `at_mm` (2,)."""
    none = np.zeros((0, 2))
    return Motion(np.zeros(0), none, none, none, none, np.asarray(at_mm, dtype=np.float64))


def joined_motion(parts: Sequence[Motion]) -> Motion:
    """Motions that follow each other, at least one, as one."""
    if len(parts) == 1:
        return parts[0]
    names = ("duration_s", "position_mm", "velocity_mm_s", "acceleration_mm_s2", "jerk_mm_s3")
    columns = [np.concatenate([getattr(part, name) for part in parts]) for name in names]
    return Motion(columns[0], columns[1], columns[2], columns[3], columns[4], parts[-1].end_mm)


@dataclass(frozen=True, slots=True)
class LayerStart:
    """What follows belongs to this layer."""

    number: int
    name: str


@dataclass(frozen=True, slots=True)
class OperatorPause:
    """Stop here with the pen up until the operator says go."""

    message: str


@dataclass(frozen=True, eq=False, slots=True)
class Travel:
    """Move with the pen up. From plan time `lower_at_s` on (whole ticks; None: not) the pen is being lowered for the stroke

    that follows, so that it comes to touch only after the motion's end; the Lower that follows waits for what is left.
    """

    motion: Motion
    lower_at_s: float | None = None


@dataclass(frozen=True, slots=True)
class Lift:
    """Start raising the pen; the next action begins after `wait_s` (shorter than the lift itself when they overlap)."""

    wait_s: float
    height: PenHeight = "up"


@dataclass(frozen=True, slots=True)
class Lower:
    """Start lowering the pen; the next action begins after `wait_s`. `stroke` is the stroke it is lowered for."""

    wait_s: float
    stroke: int = -1


@dataclass(frozen=True, eq=False, slots=True)
class Draw:
    """Move with the pen down along stroke number `stroke` (its place in the plan, from 0), or along a part of it.

    Without `last` the next action is the Draw of the next part, which goes on from the state at this one's end.
    """

    motion: Motion
    stroke: int
    last: bool = True


@dataclass(frozen=True, slots=True)
class Dwell:
    """Stay where the pen is for this long."""

    duration_s: float


@dataclass(frozen=True, slots=True)
class Dip:
    """Where the pen is, which is up: down for `lower_s` and `dwell_s`, and up; the next action begins `lift_s` after that.

    It is ink for the pen and not for the paper.
    """

    lower_s: float
    dwell_s: float
    lift_s: float


Action = LayerStart | OperatorPause | Travel | Lift | Lower | Draw | Dwell | Dip


def plan_seconds(action: Action) -> float:
    """How much plan time an action takes; a pause takes none of it."""
    match action:
        case Travel(motion=motion) | Draw(motion=motion):
            return motion.total_s
        case Lift(wait_s=seconds) | Lower(wait_s=seconds) | Dwell(duration_s=seconds):
            return seconds
        case Dip(lower_s=lower_s, dwell_s=dwell_s, lift_s=lift_s):
            return lower_s + dwell_s + lift_s
    return 0.0


def motions(actions: Iterable[Action]) -> Iterator[Motion]:
    """The motions of a plan's travels and draws, in order."""
    for action in actions:
        if isinstance(action, Travel | Draw):
            yield action.motion
