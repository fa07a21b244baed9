"""Fewer pieces: knots that a finished fit does not need are taken out, where its jerk hardly changes.

Stretches of calm pieces are fitted again on every m-th of their knots, with the states at both ends kept exactly, so that the
rest of the motion stays as it is and everything stays C2. What then breaks a limit or the tolerance is tried with a smaller
m, or left alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from planning.motion import banded, spline
from planning.motion.deviation import deviation
from planning.motion.fit import Fit
from planning.motion.limits import Kinematics, Limits
from planning.motion.path import Array, Ints, Mask, PathSet
from planning.motion.plan import TICK_S

# A stretch is calm where jerk changes by less than this part of its limit from piece to piece.
CALM = 0.3
# How many pieces are made one, and how long the stretches are that are tried as a whole.
MERGES = ((5, 60), (4, 32), (3, 24), (2, 24), (2, 12))
# The system must have some freedom left between the given states.
FEWEST = 4
# No piece longer than this: the board's arithmetic rounds jerk, and the error grows with the cube of time.
LONGEST_S = 0.040
TAKE = 0.9998


@dataclass(eq=False, slots=True)
class _Stretch:
    """Pieces low .. high of fit `fit`; `knots` are those kept, once found."""

    fit: int
    low: int
    high: int
    done: tuple[Ints, Array] | None = None


def fewer_pieces(
    paths: PathSet, owners: Sequence[int], fits: Sequence[Fit], limits: Limits, kinematics: Kinematics, allowed_mm: Array
) -> list[Fit]:
    """The same motions with fewer pieces. `owners` are the fits' paths, in order; `allowed_mm` (B,) each path's tolerance.

    The fits' `along_mm` are on the axis of `paths`.
    """
    stretches = [s for i, fit in enumerate(fits) for s in _calm(i, fit, limits)]
    for merge, longest in MERGES:
        stretches = [part for s in stretches for part in _split(s, longest)]
        todo = [s for s in stretches if s.done is None and (s.high - s.low) // merge >= FEWEST]
        if todo:
            _refit(todo, merge, paths, owners, fits, limits, kinematics, allowed_mm)
    return [_put_in(fit, [s for s in stretches if s.fit == i and s.done is not None]) for i, fit in enumerate(fits)]


def _calm(i: int, fit: Fit, limits: Limits) -> list[_Stretch]:
    jerk = np.diff(fit.acceleration_mm_s2, axis=0) / (fit.ticks * TICK_S)[:, None]
    jump = np.hypot(*np.diff(jerk, axis=0).T)
    calm = np.concatenate(([0], (jump < CALM * limits.jerk_mm_s3).astype(np.int8), [0]))
    edge = np.diff(calm)
    low, high = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1) + 1
    return [_Stretch(i, int(a), int(b)) for a, b in zip(low, high, strict=True) if b - a >= 2 * FEWEST]


def _split(stretch: _Stretch, longest: int) -> list[_Stretch]:
    if stretch.done is not None or stretch.high - stretch.low <= longest:
        return [stretch]
    parts = -(-(stretch.high - stretch.low) // longest)
    edges = np.rint(np.linspace(stretch.low, stretch.high, parts + 1)).astype(int)
    return [_Stretch(stretch.fit, int(a), int(b)) for a, b in pairwise(edges)]


def _chosen(stretch: _Stretch, merge: int, fit: Fit) -> Ints:
    """Every merge-th knot of the stretch, as evenly as whole pieces allow, both ends included."""
    mean = float(fit.ticks[stretch.low : stretch.high].mean()) * TICK_S
    merge = max(1, min(merge, int(LONGEST_S / mean)))
    count = max(FEWEST, -(-(stretch.high - stretch.low) // merge))
    return np.rint(np.linspace(stretch.low, stretch.high, count + 1)).astype(np.int64)


def _refit(
    todo: list[_Stretch], merge: int, paths: PathSet, owners: Sequence[int], fits: Sequence[Fit], limits: Limits,
    kinematics: Kinematics, allowed_mm: Array,
) -> None:  # fmt: skip
    """One banded system for all stretches; those that keep every bound are marked done."""
    kept = [_chosen(s, merge, fits[s.fit]) for s in todo]
    clocks = [np.concatenate(([0], np.cumsum(fits[s.fit].ticks[s.low : s.high]))) * TICK_S for s in todo]
    spacing = np.concatenate([np.diff(c[k - s.low]) for s, k, c in zip(todo, kept, clocks, strict=True)])
    count = np.array([len(k) - 1 for k in kept])
    lay = spline.layout(spacing, count, float(spacing.mean()))
    last = lay.first + count
    rows = np.concatenate([lay.first + k for k in range(3)] + [last + k for k in range(3)])
    head = spline.control_of_state(lay, lay.first, *_states(todo, fits, [s.low for s in todo]))
    tail = spline.control_of_state(lay, last, *_states(todo, fits, [s.high for s in todo]))
    target = np.zeros((len(lay.block), 2))
    target[lay.is_knot] = np.concatenate([fits[s.fit].position_mm[k] for s, k in zip(todo, kept, strict=True)])
    weight = np.where(lay.is_knot, 1.0, 0.0)
    zero = np.zeros(len(weight))
    anchors = _between(todo, kept, clocks, lay, fits)
    control = banded.solve(lay, zero, zero, (weight, zero, weight), target, anchors, np.ones(len(anchors.row)),
                           banded.Fixed(rows, np.concatenate(head + tail)))  # fmt: skip
    states = [x.copy() for x in lay.knot_values(control)]
    for at, knots in ((lay.first, [s.low for s in todo]), (last, [s.high for s in todo])):
        for mine, exact in zip(states, _states(todo, fits, knots), strict=True):
            mine[at] = exact
    good = _within(lay, states, limits, kinematics)
    good &= _near(todo, kept, lay, states, paths, owners, fits, allowed_mm)
    for i in np.flatnonzero(good):
        part = slice(int(lay.first[i]), int(last[i]) + 1)
        todo[i].done = (kept[i], np.stack([x[part] for x in states], axis=1))


def _states(todo: list[_Stretch], fits: Sequence[Fit], knots: list[int]) -> tuple[Array, Array, Array]:
    pairs = list(zip(todo, knots, strict=True))
    return (
        np.stack([fits[s.fit].position_mm[k] for s, k in pairs]),
        np.stack([fits[s.fit].velocity_mm_s[k] for s, k in pairs]),
        np.stack([fits[s.fit].acceleration_mm_s2[k] for s, k in pairs]),
    )


def _between(
    todo: list[_Stretch], kept: list[Ints], clocks: list[Array], lay: spline.Layout, fits: Sequence[Fit]
) -> banded.Anchors:
    """The knots that are taken out stay as points to pass near."""
    rows, after, points = [], [], []
    for i, (s, k, clock) in enumerate(zip(todo, kept, clocks, strict=True)):
        out = np.setdiff1d(np.arange(s.low, s.high + 1), k)
        piece = np.searchsorted(k, out, side="right") - 1
        rows.append(lay.first[i] + piece)
        after.append(clock[out - s.low] - clock[k[piece] - s.low])
        points.append(fits[s.fit].position_mm[out])
    row = np.concatenate(rows)
    metric = np.tile(np.array([1.0, 0.0, 1.0]), (len(row), 1))
    return banded.Anchors(row, spline.basis_at(lay, row, np.concatenate(after)), np.concatenate(points), metric)


def _within(lay: spline.Layout, states: list[Array], limits: Limits, kinematics: Kinematics) -> Mask:
    _, v, a = states
    j = np.zeros_like(a)
    j[:-1] = np.diff(a, axis=0) / lay.spacing_s[:-1, None]
    speed = np.hypot(*v.T) / limits.speed_mm_s
    jerk = np.hypot(*j.T)
    fast = np.maximum(speed, np.concatenate((speed[1:], speed[-1:]))) + jerk * lay.spacing_s**2 / 8.0 / limits.speed_mm_s
    fast = np.maximum(fast, kinematics.step_rate_share(v, a, j, lay.spacing_s))
    over = np.maximum(np.where(lay.is_interval, np.maximum(jerk / limits.jerk_mm_s3, fast), 0.0),
                      np.where(lay.is_knot, np.hypot(*a.T) / limits.acceleration_mm_s2, 0.0))  # fmt: skip
    return np.asarray(np.maximum.reduceat(over, lay.first) <= TAKE)


def _near(
    todo: list[_Stretch], kept: list[Ints], lay: spline.Layout, states: list[Array], paths: PathSet, owners: Sequence[int],
    fits: Sequence[Fit], allowed_mm: Array,
) -> Mask:  # fmt: skip
    """Which stretches still keep their distance to the path, both ways."""
    row = np.flatnonzero(lay.is_interval)
    block = lay.block[row]
    path = np.array([owners[s.fit] for s in todo])
    along = [fits[s.fit].along_mm for s in todo]
    span = (path, np.array([x[s.low] for x, s in zip(along, todo, strict=True)]),
            np.array([x[s.high] for x, s in zip(along, todo, strict=True)]), states[0][lay.first + lay.intervals])  # fmt: skip
    guess = np.concatenate([x[k[:-1]] for x, k in zip(along, kept, strict=True)])
    jerk = (states[2][row + 1] - states[2][row]) / lay.spacing_s[row, None]
    pieces = (states[0][row], states[1][row], states[2][row], jerk)
    miss, _ = deviation(paths, pieces, lay.spacing_s[row], block, span, guess, 0.85 * float(allowed_mm.min()))
    good = np.ones(len(todo), dtype=np.bool_)
    good[block[miss > allowed_mm[path[block]]]] = False
    return good


def _put_in(fit: Fit, stretches: list[_Stretch]) -> Fit:
    if not stretches:
        return fit
    keep = np.ones(len(fit.position_mm), dtype=np.bool_)
    states = np.stack((fit.position_mm, fit.velocity_mm_s, fit.acceleration_mm_s2), axis=1)
    for s in stretches:
        assert s.done is not None
        keep[s.low : s.high + 1] = False
        keep[s.done[0]] = True
        states[s.done[0]] = s.done[1]
    clock = np.concatenate(([0], np.cumsum(fit.ticks)))[keep]
    states = states[keep]
    return replace(fit, ticks=np.diff(clock), position_mm=states[:, 0], velocity_mm_s=states[:, 1],
                   acceleration_mm_s2=states[:, 2], along_mm=fit.along_mm[keep])  # fmt: skip
