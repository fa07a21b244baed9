"""Less time for what has been found, where it leaves something of every bound.

The solver only ever adds time, in steps, so that what it finds is a few per cent slow here and there. Each turn takes stretches
whose jerk, acceleration, speed and distance to the path all stay below their bounds for a while, wants them in less time, and
looks for a motion between the same states that is within its bounds all the same (`interior`). Where none is found, nothing
changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planning.motion import interior, spline
from planning.motion.fit import Fit
from planning.motion.levelling import AIM_SPEED, FEWEST_INTERVALS, Block, Levelling, knots, spliced
from planning.motion.path import Array
from planning.motion.plan import TICK_S
from planning.motion.windows import even_over_three, highest_around

# Turn by turn: how much faster or slower any place becomes at most, and what part of the way to its bounds it goes.
STEPS = (0.08, 0.05, 0.03)
GAINS = (0.7, 0.6, 0.45)
# Places are made to use this much of what is aimed at; what is aimed at is a little less than the limits.
USE = 1.005
# Stretches have about this many knots; from turn to turn they move by half of one.
KNOTS = 32
# Not tried for less time than this part of a stretch; nor for less than the other where pieces are longer than knot spacings by
# CALM: short ones take their place.
LEAST, LEAST_CALM, CALM = 0.003, 0.012, 1.4
# How finely a motion is followed from knot to knot when it is stretched.
PARTS = 4


@dataclass(frozen=True, eq=False, slots=True)
class _Stretch:
    """Part of fit number `owner`, and when its knots (n,) are and should be; `fit` has the states, `block` the work."""

    owner: int
    block: Block
    fit: Fit
    old_s: Array
    new_s: Array

    def places(self) -> tuple[Array, Array]:
        """Old times, PARTS to a piece, and how far along the pen is then: cubic between the knots, never backwards."""
        h = np.diff(self.old_s)[:, None]
        x = np.arange(PARTS)[None, :] / PARTS
        p0, way = self.fit.along_mm[:-1, None], np.diff(self.fit.along_mm)[:, None]
        speed = np.hypot(*self.fit.velocity_mm_s.T)[:, None]
        m0, m1 = np.minimum(speed[:-1] * h, 3.0 * way), np.minimum(speed[1:] * h, 3.0 * way)
        place = p0 + x * (m0 + x * (3.0 * way - 2.0 * m0 - m1 + x * (m0 + m1 - 2.0 * way)))
        time = self.old_s[:-1, None] + x * h
        place = np.maximum.accumulate(np.append(place.ravel(), self.fit.along_mm[-1]))
        return np.append(time.ravel(), self.old_s[-1]), place

    def positions(self, t: Array) -> Array:
        """Where the pen is at old times t (m,)."""
        i = np.clip(np.searchsorted(self.old_s, t, side="right") - 1, 0, len(self.old_s) - 2)
        x, h = (t - self.old_s[i])[:, None], (self.old_s[i + 1] - self.old_s[i])[:, None]
        a = self.fit.acceleration_mm_s2
        j = (a[i + 1] - a[i]) / h
        return np.asarray(self.fit.position_mm[i] + x * (self.fit.velocity_mm_s[i] + x * (a[i] / 2.0 + x * j / 6.0)))


def hastened(levelling: Levelling, fits: Sequence[Fit], roots: Sequence[Block]) -> list[Fit]:
    """The fits, each of its root block, faster where they can be. Roots in order of s."""
    current = list(fits)
    live = np.ones(len(current), dtype=np.bool_)
    for turn in range(len(STEPS)):
        which = np.flatnonzero(live).tolist()
        if not which:
            break
        missed, _ = levelling.deviations([current[i] for i in which], [roots[i] for i in which])
        tries: list[_Stretch] = []
        for i, miss in zip(which, missed, strict=True):
            tries += _slack(levelling, i, current[i], miss, roots[i], turn)
        if not tries:
            break
        _shorten(levelling, tries)
        live[:] = False
        changed: dict[int, list[tuple[int, int, Fit]]] = {}
        for s in tries:
            live[s.owner] = True
            if s.block.fit is not None:
                changed.setdefault(s.owner, []).append((s.block.low, s.block.high, s.block.fit))
        _put_in(levelling, current, changed, roots)
    return current


def _put_in(
    levelling: Levelling, fits: list[Fit], changed: dict[int, list[tuple[int, int, Fit]]], roots: Sequence[Block]
) -> None:
    """Replace stretches of the fits, all but those that take the whole off its path."""
    for _ in range(2):
        which = sorted(i for i, patches in changed.items() if patches)
        if not which:
            return
        new = [spliced(fits[i], changed[i]) for i in which]
        missed, _ = levelling.deviations(new, [roots[i] for i in which])
        again: dict[int, list[tuple[int, int, Fit]]] = {}
        for i, fit, miss in zip(which, new, missed, strict=True):
            bad = np.flatnonzero(miss > levelling.allowed(roots[i].path))
            if not len(bad):
                fits[i] = fit
                continue
            shift, good = 0, []
            for low, high, other in changed[i]:
                first = low + shift
                shift += len(other.ticks) - (high - low)
                if not ((bad >= first - 2) & (bad < high + shift + 2)).any():
                    good.append((low, high, other))
            again[i] = good
        changed = again


def _slack(levelling: Levelling, owner: int, fit: Fit, miss: Array, root: Block, turn: int) -> list[_Stretch]:
    """The stretches of `fit` worth a try. `miss` (n,) is how far each piece is off the path."""
    h = (fit.ticks * TICK_S).astype(np.float64)
    clock = np.concatenate(([0.0], np.cumsum(h)))
    if clock[-1] < FEWEST_INTERVALS * levelling.spacing_s:
        return []
    acceleration = np.hypot(*fit.acceleration_mm_s2.T) / levelling.accel
    speed = np.hypot(*fit.velocity_mm_s.T) / levelling.speed
    jerk = np.diff(fit.acceleration_mm_s2, axis=0) / h[:, None]
    motor = levelling.kinematics.step_rate_share(fit.velocity_mm_s[:-1], fit.acceleration_mm_s2[:-1], jerk, h) / AIM_SPEED
    # By how much time itself could be scaled: jerk goes with its cube, acceleration with its square.
    used = np.maximum(np.cbrt(np.hypot(*jerk.T) / levelling.jerk), (miss / levelling.tolerance) ** 0.6)
    used = np.maximum(used, np.sqrt(np.maximum(acceleration[1:], acceleration[:-1])))
    used = np.maximum(np.maximum(used, motor), np.maximum(speed[1:], speed[:-1]))
    spacing = levelling.spacing_s
    fine = np.arange(0.5, max(1.0, clock[-1] / spacing)) * spacing
    piece = np.clip(np.searchsorted(clock, fine, side="right") - 1, 0, len(h) - 1)
    width = 2 * int(np.ceil(0.5 * levelling.window_s / spacing)) + 1
    used = even_over_three(highest_around(used[piece], width))
    factor = np.clip(used / USE, 1.0 - STEPS[turn], 1.0 + STEPS[turn]) ** GAINS[turn]
    edge = np.concatenate(([0.0], fine[:-1] + 0.5 * spacing, clock[-1:]))
    wanted = np.interp(clock, edge, np.concatenate(([0.0], np.cumsum(factor * np.diff(edge)))))
    parts = max(1, round(clock[-1] / (KNOTS * spacing)))
    cuts = np.linspace(0.0, clock[-1], parts + 1)
    if parts > 1 and turn % 2:
        cuts = np.concatenate(([0.0], 0.5 * (cuts[1:] + cuts[:-1]), cuts[-1:]))
    knot = np.unique(np.clip(np.searchsorted(clock, cuts), 0, len(h)))
    old, new = np.diff(clock[knot]), np.diff(wanted[knot])
    least = np.where(old > CALM * spacing * np.diff(knot), LEAST_CALM, LEAST)
    worth = np.flatnonzero((old >= FEWEST_INTERVALS * spacing) & (new < (1.0 - least) * old))
    return [
        _Stretch(owner, _block(fit, root, low, high), fit.between(low, high), clock[low : high + 1] - clock[low],
                 wanted[low : high + 1] - wanted[low])
        for low, high in zip(knot[worth].tolist(), knot[worth + 1].tolist(), strict=True)
    ]  # fmt: skip


def _block(fit: Fit, root: Block, low: int, high: int) -> Block:
    count = len(fit.ticks)
    start, end = (np.stack((fit.position_mm[k], fit.velocity_mm_s[k], fit.acceleration_mm_s2[k])) for k in (low, high))
    return Block(root.path, float(fit.along_mm[low]) if low else root.from_s,
                 float(fit.along_mm[high]) if high < count else root.to_s, start, end,
                 root.moving_start or low > 0, root.moving_end or high < count, root, low, high)  # fmt: skip


def _shorten(levelling: Levelling, tries: list[_Stretch]) -> None:
    """Look for motions in the wanted times, all in one system. Sets `fit` of the blocks for which one is found."""
    blocks = [t.block for t in tries]
    intervals, ticks = knots(np.array([t.new_s[-1] for t in tries]), levelling.spacing_s)
    lay = spline.layout((ticks * TICK_S).astype(np.float64), intervals, levelling.spacing_s)
    corner, of = levelling.corners_inside(blocks)
    corner_s = levelling.paths.s_mm[corner]
    edges = np.searchsorted(of, np.arange(len(tries) + 1))
    s, position, at = np.empty(len(lay.block)), np.empty((len(lay.block), 2)), np.empty(len(corner))
    for i, t in enumerate(tries):
        part = slice(int(lay.first[i]), int(lay.first[i]) + int(intervals[i]) + 3)
        duration = lay.time_s[part][intervals[i]]
        clock = np.minimum(lay.time_s[part] * (t.new_s[-1] / duration), t.new_s[-1])
        old = np.interp(clock, t.new_s, t.old_s)
        fine, place = t.places()
        s[part] = np.interp(old, fine, place)
        s[part][intervals[i] :] = t.block.to_s
        position[part] = t.positions(old)
        mine = slice(edges[i], edges[i + 1])
        # Where the pen stays beside a corner for a while, its time is the first of it.
        at[mine] = np.interp(np.interp(corner_s[mine], place, fine), t.old_s, t.new_s)
    anchors = levelling.anchors(corner, of, at, lay)
    interior.meet(levelling, levelling.system(blocks, lay, s, anchors, of, None), position)
