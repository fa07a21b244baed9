"""Fewer, longer pieces, where the queue would hold too little motion, and no further off the plan than that takes.

A plan's knots come every few milliseconds; as many commands of that length as a board queues are a quarter of a second.
Neighbours become one cubic, first where the plan is nearly one anyway; where the pieces that are queued together still last
less than is wanted, the next grade lets them be further off, up to the most that is allowed. How far a merged piece really is
off is measured after the fit (`encode_fit`), and a piece that is further off than its grade, steeper than the plan, or turns
back where the plan does not, is cut in two until it is not: in the end it is the plan's own.

Knots come every 8 ms or so, and an error goes with the fourth power of a piece's length: where three are a third of what is
allowed, four are too much. Where that leaves the queue too little, borders are looked for three times as closely, and moved to
their neighbours' cost before anything is cut.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from output.ebb.arithmetic import ONE_STEP
from output.ebb.encode_fit import Plan, fit
from output.ebb.encode_pieces import Borders, subdivide

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

# Shares of the most that merging may be off, in the order in which they are tried.
GRADES = (0.1, 0.25, 0.5, 0.75, 1.0)
_MOST_MERGED = 36
# Pieces of the plan that are worked on together, and merged ones before them that are looked back at: more than a queue holds.
_AT_ONCE = 8192
_SEEN_BEFORE = 64
# Ticks: integers resolve the middle of a piece of 100 ms to 0.03 step (`encode_pieces.split`).
_LONGEST = 2500
# A cubic with the plan's own ends is two to four times further off than the best fit; with 3 too many are cut in two again.
_WORSE = 2.2
# Ticks between the places for borders where they are looked for closely. There pieces may be tried a little longer, as few of
# them need be cut: in so many fits borders are moved first.
_CLOSE = 68
_WORSE_CLOSE = 2.4
_MOVED = 4
_FIRST_CLOSE = 3
# How far a piece may be off, as a share of what it may, to take a place from one that is off too far.
_SPARE = 0.8
# The fewest such places that a piece is cut to; what is too long even so becomes the plan's own pieces.
_SHORTEST_HALF = 3
# So little motion, or so small a share of the wanted lead, is not worth the closer look; nor is a motion of which no two pieces
# can be one.
_FEW, _WORTH = 8, 0.01
# Fits in which bad pieces are cut in two, and fits after which all is left as planned; in between bad ones become the plan's.
_HALVED = 5
_MOST_FITS = 16

Lacking = Callable[[Ints], Array]


def merge(borders: Borders, most_steps: float, lacking: Lacking, to_mm: Array) -> Borders:
    """Merge neighbours while `lacking` says of pieces with these ticks (k,) that they lie where too little would be queued: by
    which share of what is wanted, 0 where enough is.

    The result is at most `most_steps` off; `to_mm` (2, 2) turns rows of motor units into millimetres.
    """
    if len(borders) < 2 or most_steps <= 0 or not lacking(borders.ticks).any():
        return borders
    parts: list[Borders] = []
    # So many at a time take a few megabytes, and no more rounds than they need.
    for first in range(0, len(borders), _AT_ONCE):
        last = min(first + _AT_ONCE, len(borders))
        part = Borders(borders.x[first : last + 1], borders.v[first : last + 1], borders.ticks[first:last])
        before = parts[-1].ticks[-_SEEN_BEFORE:] if parts else part.ticks[:0]
        parts.append(_merged(part, most_steps, _after(before, lacking), to_mm))
    return Borders(
        np.vstack([*(part.x[:-1] for part in parts), borders.x[-1:]]),
        np.vstack([*(part.v[:-1] for part in parts), borders.v[-1:]]),
        np.concatenate([part.ticks for part in parts]),
    )


def _after(before: Ints, lacking: Lacking) -> Lacking:
    """`lacking` for pieces that come after these."""
    return lambda ticks: lacking(np.concatenate((before, ticks)))[len(before) :]


def _merged(borders: Borders, most_steps: float, lacking: Lacking, to_mm: Array) -> Borders:
    if len(borders) < 2 or not lacking(borders.ticks).any():
        return borders
    merged = _graded(borders, most_steps, lacking, to_mm)
    if _FEW <= len(merged) <= len(borders) / 2 and _short(merged, lacking) > _WORTH:
        parts = np.maximum(np.rint(borders.ticks / _CLOSE).astype(np.int64), 1)
        other = _graded(subdivide(borders, parts), most_steps, lacking, to_mm, np.concatenate(([0], np.cumsum(parts))))
        return min(merged, other, key=lambda found: _short(found, lacking))
    return merged


def _short(borders: Borders, lacking: Lacking) -> float:
    """By which share of what is wanted the queue is short, over the time of the motion."""
    return float((lacking(borders.ticks) * borders.ticks).sum() / borders.ticks.sum())


def _graded(borders: Borders, most_steps: float, lacking: Lacking, to_mm: Array, knots: Ints | None = None) -> Borders:
    """Merged, with these borders as the places for borders; each piece as little off as will do.

    `knots` are those that are the plan's own, when the others are only for a closer look.
    """
    wanting, close = lacking(borders.ticks) > 0, knots is not None
    plan = Plan(borders, to_mm, places=2 if close else 3)
    knots = np.arange(len(borders) + 1) if knots is None else knots
    allowed = np.array(GRADES) * most_steps * ONE_STEP
    lengths = _lengths(plan, allowed * (_WORSE_CLOSE if close else _WORSE))
    # The closer look is taken where the last grade was not enough.
    grade = np.where(wanting, _FIRST_CLOSE if close else 0, -1)
    everywhere = np.arange(len(borders))
    while True:
        kept = _walked(np.where(grade < 0, 1, lengths[grade, everywhere]))
        # Before the fit, which costs more and only makes pieces shorter; and then what it has really come to.
        if _raised(grade, kept, lacking(np.diff(plan.time[kept])) > 0):
            continue
        fitted, kept = _fitted(plan, kept, allowed[np.maximum(grade, 0)], knots, _MOVED if close else 0)
        if not _raised(grade, kept, lacking(fitted.ticks) > 0):
            return fitted


def _raised(grade: Ints, kept: Ints, lacks: Flags) -> bool:
    """Raise the `grade` (n,) of the plan's pieces of which the pieces between `kept` (k + 1,) are made where one `lacks` (k,).

    False when none can be raised.
    """
    more = np.repeat(lacks, np.diff(kept)) & (grade < len(GRADES) - 1)
    grade[more] += 1
    return bool(more.any())


def _walked(length: Ints) -> Ints:
    """The borders that are kept when each piece is as long as it may be from where it starts."""
    kept, at, lengths, n = [], 0, length.tolist(), len(length)
    while at < n:
        kept.append(at)
        at += lengths[at]
    return np.array([*kept, n])


def _lengths(plan: Plan, tolerances: Array) -> Ints:
    """(tolerances, n): how many of the plan's pieces may be one from each place on, if it had the plan's ends."""
    n = len(plan.borders)
    lengths = np.ones((len(tolerances), n), dtype=np.int64)
    starts = np.arange(n)
    missed = np.zeros(n, dtype=np.int64)
    for m in range(2, min(_MOST_MERGED, n) + 1):
        starts = starts[starts + m <= n]
        starts = starts[(plan.time[starts + m] - plan.time[starts] <= _LONGEST) & (missed[starts] < 2)]
        if not len(starts):
            break
        off = _off(plan.borders, plan.time, starts, m)
        for grade, tolerance in enumerate(tolerances):
            lengths[grade, starts[off <= tolerance]] = m
        # Errors grow with the length: what has not fitted twice will not.
        missed[starts] = np.where(off <= tolerances[-1], 0, missed[starts] + 1)
    return lengths


def _off(borders: Borders, time: Ints, starts: Ints, m: int) -> Array:
    """How far the cubics over `m` pieces, their ends the plan's, are off it at up to three places in between."""
    t = (time[starts + m] - time[starts])[:, None].astype(np.float64)
    x0, x1, v0, v1 = borders.x[starts], borders.x[starts + m], borders.v[starts], borders.v[starts + m]
    off = np.zeros(len(starts))
    for inner in sorted({max(m // 4, 1), m // 2, m - max(m // 4, 1)}):
        u = (time[starts + inner] - time[starts])[:, None] / t
        cubic = x0 + u * u * (3 - 2 * u) * (x1 - x0) + u * (1 - u) * t * ((1 - u) * v0 - u * v1)
        off = np.maximum(off, np.abs(cubic - borders.x[starts + inner]).max(axis=1))
    return off


def _fitted(plan: Plan, kept: Ints, allowed: Array, knots: Ints, moves: int) -> tuple[Borders, Ints]:
    """The best motion over these borders, with shorter pieces where it is not good enough, and the borders it has then.

    `allowed` (n,) is how far each of the plan's pieces may be off. In the first `moves` fits borders are moved, not added. No
    piece becomes shorter than those between the plan's own `knots`.
    """
    as_planned = np.arange(len(plan.borders) + 1)
    if len(kept) == len(as_planned):
        return plan.borders, as_planned
    pinned = np.zeros(len(plan.borders) + 1, dtype=np.bool_)
    pinned[[0, -1]] = True
    # The plan's own piece that each place lies in, and the one that ends there.
    begun, ended = np.searchsorted(knots, as_planned, side="right") - 1, np.searchsorted(knots, as_planned)
    shortest = 1 if len(knots) == len(as_planned) else _SHORTEST_HALF
    for fits in range(_MOST_FITS):
        fitted = fit(plan, kept, pinned[kept])
        # What its neighbours may be off, a piece may be too: the fit spreads it.
        limit = np.maximum.reduceat(allowed, kept[:-1])
        limit = np.maximum(limit, np.maximum(np.append(limit[1:], 0.0), np.append(0.0, limit[:-1])))
        starts, ends = kept[:-1], kept[1:]
        held, far = pinned[starts] & pinned[ends], fitted.off > limit
        bad = (far | fitted.bad) & ~(held & (ended[ends] - begun[starts] == 1))
        if not bad.any():
            return fitted.borders, kept
        if fits < moves:
            kept = _moved(kept, bad, fitted.off / limit, pinned)
        elif fits < moves + _HALVED:
            # Ends that are the plan's own keep a piece from turning back; if they are already, or it is too far off, it is cut.
            halves = bad & (held | far)
            pinned[starts[bad & ~halves]] = pinned[ends[bad & ~halves]] = True
            short = ends - starts < 2 * shortest
            kept = np.union1d(kept, (starts[halves & ~short] + ends[halves & ~short]) // 2)
            bad = halves & short
        if fits >= moves:
            for first, last in zip(begun[starts[bad]].tolist(), ended[ends[bad]].tolist(), strict=True):
                # The plan's own pieces instead, whole ones, and no crumbs beside them.
                near = (kept > knots[first] - shortest) & (kept < knots[last] + shortest)
                inside = (kept >= knots[first]) & (kept <= knots[last])
                kept = np.union1d(kept[~inside & (~near | pinned[kept])], knots[first : last + 1])
                pinned[knots[first] : knots[last] + 1] = False
                pinned[knots[first : last + 1]] = True
    return plan.borders, as_planned


def _moved(kept: Ints, bad: Flags, share: Array, pinned: Flags) -> Ints:
    """Each bad piece shorter by a place, which the better of its neighbours gets if its `share` (k,) of what it may be off
    leaves it some to spare."""
    # What cannot give: pieces that are bad themselves, pieces behind a border that stays, and what is before the first and
    # after the last.
    spare = np.concatenate(([np.inf], np.where(bad, np.inf, share), [np.inf]))
    left, right = spare[:-2], spare[2:]
    left = np.where(pinned[kept[:-1]], np.inf, left)
    right = np.where(pinned[kept[1:]], np.inf, right)
    able = bad & (np.diff(kept) > 2) & (np.minimum(left, right) < _SPARE)
    begins, ends = able & (left < right), able & (left >= right)
    # A border between two that both want it stays where it is.
    moved = kept.copy()
    moved[:-1] += begins
    moved[1:] -= ends
    return moved
