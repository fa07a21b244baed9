"""Making stretches meet all their bounds, or finding that they cannot: an interior-point method on a whole system at once.

Lawson's weights say where a stretch lacks time, but close the last few per cent slowly. Once a stretch is near, three to eight
Newton steps on a barrier (`barrier`) bring it within its bounds, where that can be done at all.
"""

from __future__ import annotations

import numpy as np
from numpy.linalg import LinAlgError

from planning.motion import banded, barrier
from planning.motion.levelling import Levelling, Rows, kept
from planning.motion.path import Array, Mask

ROUNDS = 10
# The barrier's weight grows by this after a step that could be made almost whole, and after one that could be made in part.
BOLD, STEADY = 4.0, 1.6
# A step goes this far towards the first bound it would meet.
SHORTENED = 0.92
# Given up when the least u that seems possible is above 1: this many times the gap that the barrier leaves is allowed for.
GAP, FEWEST_ROUNDS = 1.5, 3
# The first guess is smoothed by this weight of jerk against distance.
START_JERK = 0.01
# Off by this part of the tolerance more between knots than at them: a bend's swing, which a little less room there mends.
SWING = 0.2


def meet(levelling: Levelling, rows: Rows, position_mm: Array) -> None:
    """Look near the knots' positions (M, 2) for a motion of each block that keeps every bound; sets `fit` of those taken.

    Where arithmetic is at its end (a margin of nothing) the search just ends: nothing has been lost by it.
    """
    lay = rows.lay
    on = np.where(lay.is_knot, 1.0, 0.0)
    none = banded.Anchors(np.zeros(0, dtype=np.int64), np.zeros((4, 0)), np.zeros((0, 2)), np.zeros((0, 3)))
    smooth = np.where(lay.is_interval, START_JERK * (levelling.tolerance / levelling.jerk) ** 2, 0.0)
    zero = np.zeros(len(on))
    control = banded.solve(lay, smooth, zero, (on, zero, on), position_mm, none, np.zeros(0), rows.fixed)
    # Room and metric are narrowed here; the caller's stay as they are.
    rows = kept(rows, np.ones(len(rows.blocks), dtype=np.bool_))
    u = tau = np.zeros(0)
    for turn in range(ROUNDS):
        bounds = _bounds(levelling, rows)
        ratios = barrier.ratios(bounds, control)
        worst = barrier.greatest(bounds, ratios)
        done = _taken(levelling, rows, control, worst)
        if turn == 0:
            u = 1.05 * worst + 0.01
            tau = barrier.balanced(bounds, ratios, u)
        u = np.maximum(u, 1.0001 * worst)
        lost = (u - GAP * barrier.constraints(bounds) / tau > 1.0) & (turn > FEWEST_ROUNDS)
        keep = ~done & ~lost
        if not keep.any():
            return
        if not keep.all():
            control, u, tau = control[keep[rows.lay.block]], u[keep], tau[keep]
            rows = kept(rows, keep)
        if done.any() or not keep.all():
            bounds = _bounds(levelling, rows)
        ratios = barrier.ratios(bounds, control)
        u = np.maximum(u, 1.0001 * barrier.greatest(bounds, ratios))
        try:
            step, step_u = barrier.newton(bounds, ratios, u, tau)
        except LinAlgError:
            return
        change = barrier.ratios(bounds, step, moving=True)
        size = np.minimum(1.0, SHORTENED * barrier.furthest(bounds, ratios, change, u, step_u))
        if not (np.isfinite(step).all() and np.isfinite(size).all()):
            return
        control = control + step * size[rows.lay.block][:, None]
        u = u + step_u * size
        tau = tau * np.where(size > 0.7, BOLD, np.where(size > 0.3, STEADY, 1.0))


def _bounds(levelling: Levelling, rows: Rows) -> barrier.Bounds:
    return barrier.Bounds(
        rows.lay, rows.target, rows.tangent, rows.room, rows.anchors, rows.anchor_block, rows.fixed,
        levelling.speed, levelling.accel, levelling.jerk, levelling.tolerance,
    )  # fmt: skip


def _taken(levelling: Levelling, rows: Rows, control: Array, worst: Array) -> Mask:
    """Which blocks (B,) are taken now; those that are too far off their path between their knots get less room there."""
    none = np.zeros(len(rows.blocks), dtype=np.bool_)
    if worst.min() > 1.05:
        return none
    *_, over, states = levelling.ratios(rows, control)
    ready = np.maximum.reduceat(over, rows.lay.first) <= 1.0
    if not ready.any():
        return none
    done = levelling.take(rows, ready, states, over)
    if (ready & ~done).any():
        _narrow(levelling, rows, states[0], ready & ~done)
    return done


def _narrow(levelling: Levelling, rows: Rows, position: Array, failed: Mask) -> None:
    """Less room for the failed blocks (B,) where their pieces are too far off the path (`rows.miss`)."""
    lay = rows.lay
    allowed = levelling.limits.tolerance_mm * 0.9999 - levelling.slack[rows.path]
    bad = np.flatnonzero((rows.miss > allowed) & failed[lay.block] & lay.is_interval)
    offset = position - rows.target
    sideways = np.abs(offset[:, 1] * rows.tangent[:, 0] - offset[:, 0] * rows.tangent[:, 1])
    between = rows.miss[bad] - np.maximum(sideways[bad], sideways[bad + 1])
    swing = between < SWING * levelling.tolerance
    room = 0.99 * allowed[bad[swing]] - np.maximum(between[swing], 0.0)
    np.minimum.at(rows.room, bad[swing], room)
    np.minimum.at(rows.room, bad[swing] + 1, room)
    # Elsewhere it is a corner that is cut or overshot.
    rows.room[bad[~swing]] *= 0.95
    rows.anchors.metric[np.isin(rows.anchors.row, bad[~swing])] *= 1.1
