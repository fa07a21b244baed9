"""One banded system for many stretches of paths, and levelling it: jerk, acceleration and distance, each over its bound.

A stretch (`Block`) goes from one state to another in a given time; where its knots should be along the path is given too.
Lawson's multiplicative weights level the three kinds of ratios; a stretch is taken when it keeps every bound and, verified on
its own, its distance to the path both ways. Stretches do not touch each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from planning.motion import banded, spline
from planning.motion.deviation import deviation
from planning.motion.fit import Fit, joined
from planning.motion.limits import Kinematics, Limits
from planning.motion.path import Array, Ints, Mask, PathSet
from planning.motion.plan import TICK_S

# The fit aims a little below the limits, and is taken when it is within the limits themselves (less rounding).
AIM_SPEED, AIM_ACCELERATION, AIM_JERK, AIM_TOLERANCE = 0.996, 0.996, 0.99, 0.975
TAKE = 0.9998
# Levelling aims a little lower still, so that the last few places come down too.
LEVEL, LEVEL_TOLERANCE = 0.975, 0.92
FEWEST_INTERVALS = 6
# After this many rounds the weights should have settled; what follows is done in smaller steps.
SETTLED = 16
TANGENTIAL_WEIGHT = 0.05


@dataclass(eq=False, slots=True)
class Block:
    """One piece of work: a stretch of a path between two states. A root covers its section; patches mend the bad places of a
    root's fit.

    `low`, `high` are the knots of the root's draft that a patch replaces.
    """

    path: int
    from_s: float
    to_s: float
    start: Array
    end: Array
    moving_start: bool
    moving_end: bool
    root: Block | None = None
    low: int = 0
    high: int = 0
    stage: int = 0
    widened: int = 0
    fit: Fit | None = None
    draft: Fit | None = None
    patches: list[Block] = field(default_factory=list)
    whole: bool = False
    slow_from: int = 0
    slow_before: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(eq=False, slots=True)
class Rows:
    """One stage's system: per-row arrays over the blocks still unsolved."""

    blocks: list[Block]
    lay: spline.Layout
    s: Array
    path: Ints
    target: Array
    tangent: Array
    room: Array
    weights: Array
    anchors: banded.Anchors
    anchor_weight: Array
    anchor_block: Ints
    fixed: banded.Fixed
    miss: Array


@dataclass(frozen=True, eq=False, slots=True)
class Best:
    """The best iterate of the blocks that were not taken: how far over its bounds each row is, and its states (M, 2)."""

    rows: Rows
    over: Array
    position: Array
    velocity: Array
    acceleration: Array


class Levelling:
    """The bounds, the paths, and the work of one system at a time."""

    def __init__(self, paths: PathSet, slack_mm: Array, limits: Limits, kinematics: Kinematics, spacing_s: float) -> None:
        self.paths = paths
        self.slack = slack_mm
        self.limits = limits
        self.kinematics = kinematics
        self.speed = AIM_SPEED * limits.speed_mm_s
        self.accel = AIM_ACCELERATION * limits.acceleration_mm_s2
        self.jerk = AIM_JERK * limits.jerk_mm_s3
        self.tolerance = AIM_TOLERANCE * limits.tolerance_mm
        self.ramp_s = self.accel / self.jerk
        self.spacing_s = spacing_s
        self.window_s = max(self.ramp_s, 2.0 * spacing_s)

    def allowed(self, path: int) -> float:
        """How far a motion may be from this path, in mm."""
        return float(self.limits.tolerance_mm * 0.9999 - self.slack[path])

    def deviations(self, fits: Sequence[Fit], blocks: Sequence[Block]) -> tuple[list[Array], list[Array]]:
        """How far each piece of each fit is off its block's path, and where along it it starts. Blocks in order of s."""
        h = [(f.ticks * TICK_S).astype(np.float64) for f in fits]
        jerk = [np.diff(f.acceleration_mm_s2, axis=0) / x[:, None] for f, x in zip(fits, h, strict=True)]
        span = (np.array([b.path for b in blocks]), np.array([b.from_s for b in blocks]), np.array([b.to_s for b in blocks]),
                np.stack([f.position_mm[-1] for f in fits]))  # fmt: skip
        pieces = (
            np.concatenate([f.position_mm[:-1] for f in fits]),
            np.concatenate([f.velocity_mm_s[:-1] for f in fits]),
            np.concatenate([f.acceleration_mm_s2[:-1] for f in fits]),
            np.concatenate(jerk),
        )
        of = np.repeat(np.arange(len(fits)), [len(x) for x in h])
        guess = np.concatenate([f.along_mm[:-1] for f in fits])
        miss, along = deviation(self.paths, pieces, np.concatenate(h), of, span, guess, 0.9 * self.tolerance)
        edges = np.cumsum([len(x) for x in h])[:-1]
        return np.split(miss, edges), np.split(along, edges)

    # --- the system ------------------------------------------------------------------------------------------------

    def system(
        self, blocks: list[Block], lay: spline.Layout, s: Array, anchors: banded.Anchors, anchor_block: Ints,
        remembered: tuple[Array, Array] | None,
    ) -> Rows:  # fmt: skip
        """Blocks whose knots should be at `s` (M,) along their paths; weights as `remembered` (s, weights (3, n)), or fresh."""
        path = np.array([b.path for b in blocks])[lay.block]
        target, tangent = self.paths.curve(s, path)
        bulge = self.paths.bulge_mm[self.paths.segment(s, path)]
        room = np.maximum(self.tolerance - bulge - self.slack[path], 0.3 * self.tolerance)
        if remembered is None:
            weights = np.tile(np.array([[0.0], [-2.0], [-2.0]]), (1, len(s)))
        else:
            # Weights must be mostly forgotten from stage to stage, or the levelling never settles.
            weights = 0.25 * np.stack([np.interp(s, remembered[0], w) for w in remembered[1]])
        return Rows(blocks, lay, s, path, target, tangent, room, weights, anchors, np.full(len(anchors.row), 2.0),
                     anchor_block, self._fixed(lay, blocks), np.zeros(len(s)))  # fmt: skip

    def _fixed(self, lay: spline.Layout, blocks: list[Block]) -> banded.Fixed:
        start, end = np.stack([b.start for b in blocks]), np.stack([b.end for b in blocks])
        last = lay.first + lay.intervals
        head = spline.control_of_state(lay, lay.first, start[:, 0], start[:, 1], start[:, 2])
        tail = spline.control_of_state(lay, last, end[:, 0], end[:, 1], end[:, 2])
        rows = np.concatenate([lay.first + k for k in range(3)] + [last + k for k in range(3)])
        return banded.Fixed(rows, np.concatenate(head + tail))

    def corners_inside(self, blocks: list[Block]) -> tuple[Ints, Ints]:
        """The corners strictly inside the blocks, and which block each is in."""
        corner = np.flatnonzero(self.paths.sharp)
        at = self.paths.s_mm[corner]
        from_s, to_s = np.array([b.from_s for b in blocks]), np.array([b.to_s for b in blocks])
        block = np.searchsorted(from_s, at, side="right") - 1
        inside = (block >= 0) & (at > from_s[block] + 1e-6) & (at < to_s[block] - 1e-6)
        return corner[inside], block[inside]

    def anchors(self, corner: Ints, block: Ints, t: Array, lay: spline.Layout) -> banded.Anchors:
        """The corners that the pen must come near at their own time: sideways, or from all sides where it nearly turns back.

        `t` (m,) is that time within the corner's block.
        """
        paths = self.paths
        offset = np.concatenate(([0.0], np.cumsum(lay.time_s[lay.first + lay.intervals] + 1.0)))[:-1]
        knot_time = lay.time_s + offset[lay.block]
        knot_time[~lay.is_interval] = np.inf
        knot_time = np.minimum.accumulate(knot_time[::-1])[::-1]
        row = np.searchsorted(knot_time, t + offset[block], side="right") - 1
        row = np.clip(row, lay.first[block], lay.first[block] + lay.intervals[block] - 1)
        after = np.clip(t - lay.time_s[row], 0.0, lay.spacing_s[row])
        unit = np.diff(paths.point_mm, axis=0) / paths.length_mm[:, None]
        along = unit[corner - 1] + unit[corner]
        norm = np.hypot(along[:, 0], along[:, 1])
        along = along / np.maximum(norm, 1e-9)[:, None]
        across = np.stack((-along[:, 1], along[:, 0]), axis=-1)
        around = np.abs(paths.turn_rad[corner]) > np.radians(100.0)
        metric = np.stack((across[:, 0] ** 2, across[:, 0] * across[:, 1], across[:, 1] ** 2), axis=-1)
        metric[around] = (1.0, 0.0, 1.0)
        metric /= ((self.tolerance - self.slack[paths.path[corner]]) ** 2)[:, None]
        return banded.Anchors(row, spline.basis_at(lay, row, after), paths.point_mm[corner], metric)

    # --- levelling -------------------------------------------------------------------------------------------------

    def level(self, rows: Rows, rounds: int) -> tuple[Best | None, tuple[Array, Array]]:
        """Reweight until every block is taken or the rounds are over. Returns the best iterate of those not taken, and all

        weights.
        """
        score = np.full(len(rows.blocks), np.inf)
        best = Best(rows, np.ones(len(rows.s)), *(np.zeros((len(rows.s), 2)) for _ in range(3)))
        for turn in range(rounds):
            control = self._solve(rows)
            ratio, anchor_ratio, local, over, states = self.ratios(rows, control)
            bad = np.add.reduceat(np.maximum(over - 1.0, 0.0), rows.lay.first)
            ready = np.maximum.reduceat(over, rows.lay.first) <= 1.0
            better = (bad < score) | ready
            score = np.minimum(score, bad)
            wish = np.where(over > 1.0, np.maximum(local, over**0.3), np.minimum(local, 1.0))
            best = _improved(best, better[rows.lay.block], wish, states)
            done = np.zeros(len(rows.blocks), dtype=np.bool_)
            if ready.any():
                done = self.take(rows, ready, states, best.over)
            if done.all():
                return None, (rows.s, rows.weights)
            self._reweigh(rows, ratio, anchor_ratio, turn)
            if done.any():
                keep = ~done
                mask = keep[rows.lay.block]
                score = score[keep]
                rows = kept(rows, keep)
                best = Best(rows, best.over[mask], best.position[mask], best.velocity[mask], best.acceleration[mask])
        valid = rows.lay.is_knot
        return best, (rows.s[valid], rows.weights[:, valid])

    def _solve(self, rows: Rows) -> Array:
        lay = rows.lay
        weight = np.exp(rows.weights)
        jerk = np.where(lay.is_interval, weight[0], 0.0) / self.jerk**2
        acceleration = np.where(lay.is_knot, weight[1], 0.0) / self.accel**2
        lateral = np.where(lay.is_knot, weight[2], 0.0) / self.tolerance**2
        along = np.where(lay.is_knot, TANGENTIAL_WEIGHT, 0.0) / self.tolerance**2
        tx, ty = rows.tangent[:, 0], rows.tangent[:, 1]
        difference = along - lateral
        metric = (lateral + difference * tx * tx, difference * tx * ty, lateral + difference * ty * ty)
        return banded.solve(lay, jerk, acceleration, metric, rows.target, rows.anchors, np.exp(rows.anchor_weight), rows.fixed)

    def ratios(self, rows: Rows, control: Array) -> tuple[Array, Array, Array, Array, tuple[Array, Array, Array, Array]]:
        """What one iterate makes of the bounds.

        Jerk, acceleration and sideways distance over their aims (3, M); corners' distances; the slow-down each row asks for
        (M,); how far each row is over its true bounds (M,), 1 being just within; and the states there.
        """
        lay = rows.lay
        q, v, a = lay.knot_values(control)
        j = np.zeros_like(a)
        j[:-1] = np.diff(a, axis=0) / lay.spacing_s[:-1, None]
        offset = q - rows.target
        sideways = np.abs(offset[:, 1] * rows.tangent[:, 0] - offset[:, 0] * rows.tangent[:, 1])
        motor = np.where(lay.is_interval, self.kinematics.step_rate_share(v, a, j, lay.spacing_s) / AIM_SPEED, 0.0)
        ratio = np.stack((
            np.where(lay.is_interval, np.hypot(j[:, 0], j[:, 1]) / self.jerk, 0.0),
            np.where(lay.is_knot, np.hypot(a[:, 0], a[:, 1]) / self.accel, 0.0),
            np.where(lay.is_knot, sideways / rows.room, 0.0),
        ))  # fmt: skip
        speed = np.where(lay.is_knot, np.hypot(v[:, 0], v[:, 1]) / self.speed, 0.0)
        anchors = rows.anchors
        at = sum(anchors.basis[k][:, None] * control[anchors.row + k] for k in range(4))
        miss = at - anchors.target
        xx, xy, yy = anchors.metric.T
        anchor_ratio = np.sqrt(np.maximum(0.0, xx * miss[:, 0] ** 2 + 2 * xy * miss[:, 0] * miss[:, 1] + yy * miss[:, 1] ** 2))
        local = np.maximum(np.maximum(np.cbrt(ratio[0]), np.sqrt(ratio[1])), np.maximum(ratio[2] ** 0.6, speed))
        local = np.maximum(local, motor)
        # Inside a piece speed exceeds that at its ends by at most |j| h^2 / 8: add that to be sure.
        fast = np.maximum(speed, np.concatenate((speed[1:], speed[-1:])))
        fast = np.maximum(fast + ratio[0] * (self.jerk / self.speed) * lay.spacing_s**2 / 8.0, motor)
        over = np.maximum(
            np.maximum(ratio[0] * (AIM_JERK / TAKE), ratio[1] * (AIM_ACCELERATION / TAKE)),
            np.maximum(ratio[2] * AIM_TOLERANCE, fast * (AIM_SPEED / TAKE)),
        )
        if len(anchor_ratio):
            np.maximum.at(local, anchors.row, anchor_ratio**0.6)
            np.maximum.at(over, anchors.row, anchor_ratio * AIM_TOLERANCE)
        return ratio, anchor_ratio, local, over, (q, v, a, j)

    def take(self, rows: Rows, ready: Mask, states: tuple[Array, Array, Array, Array], over: Array) -> Mask:
        """Verify the ready blocks' distance to their paths, both ways, and keep those that pass. Marks where the others

        fail.
        """
        lay = rows.lay
        source = np.flatnonzero(ready[lay.block] & lay.is_interval)
        chosen = [b for b, r in zip(rows.blocks, ready, strict=True) if r]
        span = (np.array([b.path for b in chosen]), np.array([b.from_s for b in chosen]), np.array([b.to_s for b in chosen]),
                np.stack([b.end[0] for b in chosen]))  # fmt: skip
        pieces = (states[0][source], states[1][source], states[2][source], states[3][source])
        of = (np.cumsum(ready) - 1)[lay.block[source]]
        miss, along = deviation(self.paths, pieces, lay.spacing_s[source], of, span, rows.s[source], 0.9 * self.tolerance)
        allowed = self.limits.tolerance_mm * 0.9999 - self.slack[rows.path[source]]
        np.maximum.at(over, source, np.where(miss > allowed, np.maximum(1.002, (miss / self.tolerance) ** 0.6), 0.0))
        failed = np.zeros(len(rows.blocks), dtype=np.bool_)
        failed[lay.block[source[miss > allowed]]] = True
        rows.weights[2, source[miss > allowed]] += 2.0
        rows.miss[:] = 0.0
        rows.miss[source] = miss
        done = ready & ~failed
        off = np.hypot(*(states[0][source] - rows.target[source]).T)
        along_rows = rows.s.copy()
        along_rows[source] = trusted(along, rows.s[source], off, span[1][of], span[2][of])
        for i in np.flatnonzero(done):
            part = slice(lay.first[i], lay.first[i] + lay.intervals[i] + 1)
            block = rows.blocks[i]
            knots = np.stack((states[0][part], states[1][part], states[2][part]), axis=1)
            knots[0], knots[-1] = block.start, block.end
            ticks = np.rint(lay.spacing_s[part][:-1] / TICK_S).astype(np.int64)
            block.fit = Fit(ticks, knots[:, 0], knots[:, 1], knots[:, 2], along_rows[part])
        return np.asarray(done)

    def _reweigh(self, rows: Rows, ratio: Array, anchor_ratio: Array, turn: int) -> None:
        """Lawson's step: weigh more what is over its aim, less what is under it; more gently once it should have settled."""
        gain = 1.0 if turn < SETTLED else 0.5
        scaled = ratio / np.array([[LEVEL], [LEVEL], [LEVEL_TOLERANCE]])
        rows.weights += gain * np.where(scaled > 1.0, 3.0, 0.5) * np.log(np.clip(scaled, 0.3, 3.0))
        np.clip(rows.weights, -40.0, 25.0, out=rows.weights)
        scaled = anchor_ratio / LEVEL_TOLERANCE
        step = gain * np.where(scaled > 1.0, 3.0, 0.5) * np.log(np.clip(scaled, 0.3, 3.0))
        rows.anchor_weight = np.clip(rows.anchor_weight + step, -40.0, 25.0)


def trusted(along: Array, s: Array, off_mm: Array, low: Array | float, high: Array | float) -> Array:
    """Where knots are along the path. Where it turns back on itself or crosses, the nearest point may be on the wrong leg:
    trust it no further than the pen is off its place."""
    return np.asarray(np.maximum.accumulate(np.clip(np.clip(along, s - 1.2 * off_mm, s + 1.2 * off_mm), low, high)))


def _improved(best: Best, where: Mask, over: Array, states: tuple[Array, Array, Array, Array]) -> Best:
    if where.all():
        return Best(best.rows, over, states[0], states[1], states[2])
    at = where[:, None]
    return Best(best.rows, np.where(where, over, best.over), np.where(at, states[0], best.position),
                 np.where(at, states[1], best.velocity), np.where(at, states[2], best.acceleration))  # fmt: skip


def spliced(fit: Fit, patches: list[tuple[int, int, Fit]]) -> Fit:
    """`fit` with the pieces from one knot to another replaced by others."""
    parts: list[Fit] = []
    at = 0
    for low, high, other in sorted(patches, key=lambda p: p[0]):
        if low > at:
            parts.append(fit.between(at, low))
        parts.append(other)
        at = high
    if at < len(fit.ticks):
        parts.append(fit.between(at, len(fit.ticks)))
    return joined(parts)


def knots(wanted_s: Array, spacing_s: float) -> tuple[Ints, Ints]:
    """Number of intervals (B,) of about `spacing_s` for each block, and the whole ticks of each interval, block after block.

    The least total not below what is wanted, as evenly spread as ticks allow.
    """
    total = np.ceil(wanted_s / TICK_S - 1e-9).astype(np.int64)
    base = spacing_s / TICK_S
    intervals = np.maximum(np.rint(total / (1.03 * base)).astype(np.int64), FEWEST_INTERVALS)
    total = np.maximum(total, intervals * int(0.5 * base))
    within = np.arange(int(intervals.sum())) - np.repeat(np.cumsum(intervals) - intervals, intervals)
    share, of = np.repeat(total, intervals), np.repeat(intervals, intervals)
    return intervals, (within + 1) * share // of - within * share // of


def kept(rows: Rows, keep: Mask) -> Rows:
    """The same system without the blocks that are done. Blocks are independent, so that rows can simply go."""
    lay = rows.lay
    mask = keep[lay.block]
    count = lay.intervals[keep]
    first = np.cumsum(count + 3) - (count + 3)
    new_block = np.cumsum(keep) - 1
    moved = np.cumsum(mask) - 1
    small = spline.Layout(first, count, new_block[lay.block[mask]], lay.time_s[mask], lay.spacing_s[mask], lay.is_knot[mask],
                          lay.is_interval[mask], lay.value[:, mask], lay.velocity[:, mask], lay.acceleration[:, mask],
                          lay.jerk[:, mask], (lay.reach[0][mask], lay.reach[1][mask], lay.reach[2][mask],
                          lay.reach[3][mask]))  # fmt: skip
    with_anchor = keep[rows.anchor_block] if len(rows.anchor_block) else np.zeros(0, dtype=np.bool_)
    fixed = mask[rows.fixed.row]
    a = rows.anchors
    anchors = banded.Anchors(moved[a.row[with_anchor]], a.basis[:, with_anchor], a.target[with_anchor], a.metric[with_anchor])
    return Rows(
        [b for b, k in zip(rows.blocks, keep, strict=True) if k], small, rows.s[mask],
        rows.path[mask], rows.target[mask], rows.tangent[mask], rows.room[mask], rows.weights[:, mask], anchors,
        rows.anchor_weight[with_anchor],
        new_block[rows.anchor_block[with_anchor]], banded.Fixed(moved[rows.fixed.row[fixed]], rows.fixed.value[fixed]),
        rows.miss[mask],
    )  # fmt: skip
