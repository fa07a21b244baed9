"""Fewer, longer pieces: neighbours become one cubic where it stays within a fraction of a step of the plan.

A plan's knots come every few milliseconds, more often than a board likes to be told. The cubic over several of them that has
both ends' positions and rates is a hair off in between; it is taken when that is less than the tolerance, when it accelerates
no more than the motion does somewhere anyway, and when it does not turn an axis back that the plan does not turn.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from output.ebb.encode_pieces import SLACK, Borders

Array = NDArray[np.float64]

_MOST_MERGED = 6
# The greatest deviation lies between the knots that are looked at; this much more at most, for curves of bounded jerk.
_BETWEEN = 1.2
_STILL = 1.0


def merge(borders: Borders, longest_ticks: int, tolerance: float, to_mm: Array) -> Borders:
    """Join up to six neighbouring pieces into one of at most `longest_ticks`, off by at most `tolerance` (2^-31 steps).

    `to_mm` (2, 2) turns rows of motor units into millimetres, by which accelerations are compared.
    """
    n = len(borders)
    if n < 2 or tolerance <= 0:
        return borders
    length = np.ones(n, dtype=np.int64)
    time = np.concatenate(([0], np.cumsum(borders.ticks)))
    steepest = _steepest(borders, to_mm)
    for m in range(2, min(_MOST_MERGED, n) + 1):
        starts = np.flatnonzero(time[m:] - time[:-m] <= longest_ticks)
        if len(starts):
            length[_fitting(borders, time, starts, m, tolerance, steepest, to_mm)] = m
    kept, at, lengths = [], 0, length.tolist()
    while at < n:
        kept.append(at)
        at += lengths[at]
    index = np.array([*kept, n])
    return Borders(borders.x[index], borders.v[index], np.diff(time[index]))


def _steepest(borders: Borders, to_mm: Array) -> float:
    """The greatest acceleration at any border, in mm per tick^2."""
    t = borders.ticks[:, None].astype(np.float64)
    mean = np.diff(borders.x, axis=0) / t
    ends = (6 * mean - 4 * borders.v[:-1] - 2 * borders.v[1:]) / t, (4 * borders.v[1:] + 2 * borders.v[:-1] - 6 * mean) / t
    return max(float(np.hypot(*(a @ to_mm).T).max()) for a in ends)


def _fitting(
    borders: Borders,
    time: NDArray[np.int64],
    starts: NDArray[np.int64],
    m: int,
    tolerance: float,
    steepest: float,
    to_mm: Array,
) -> NDArray[np.int64]:
    """Those of `starts` that may begin a piece over `m` of the old ones."""

    def cubic(starts: NDArray[np.int64]) -> tuple[Array, Array, Array, Array]:
        t = (time[starts + m] - time[starts])[:, None].astype(np.float64)
        mean = (borders.x[starts + m] - borders.x[starts]) / t
        v0, v1 = borders.v[starts], borders.v[starts + m]
        return t, v0, (6 * mean - 4 * v0 - 2 * v1) / t, (4 * v1 + 2 * v0 - 6 * mean) / t

    t, v0, a0, a1 = cubic(starts)
    gentle = np.maximum(_squares(a0 @ to_mm), _squares(a1 @ to_mm)) <= (steepest * 1.001) ** 2
    if not gentle.all():
        starts = starts[gentle]
        t, v0, a0, a1 = t[gentle], v0[gentle], a0[gentle], a1[gentle]
    jerk = (a1 - a0) / t
    x0, v1 = borders.x[starts], borders.v[starts + m]
    good = np.ones(len(starts), dtype=np.bool_)
    low, high = np.minimum(v0, v1), np.maximum(v0, v1)
    for inner in range(1, m):
        s = (time[starts + inner] - time[starts])[:, None].astype(np.float64)
        off = np.abs(x0 + s * (v0 + s * (a0 / 2 + s * jerk / 6)) - borders.x[starts + inner])
        good &= (off * _BETWEEN <= tolerance).all(axis=1)
        low, high = np.minimum(low, borders.v[starts + inner]), np.maximum(high, borders.v[starts + inner])
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = np.where(jerk != 0, -a0 / jerk, 0.0)
    turn = np.clip(turn, 0.0, t)
    middle = v0 + turn * (a0 + turn * jerk / 2)
    # A dip of a thousandth of the speed is held back when it is quantised; more would be a turn.
    slack = np.maximum(_STILL, SLACK * np.maximum(np.abs(low), np.abs(high)))
    turns = ((low >= -slack) & (middle < -slack)) | ((high <= slack) & (middle > slack))
    return starts[good & ~turns.any(axis=1)]


def _squares(vectors: Array) -> Array:
    return np.asarray((vectors * vectors).sum(axis=1))


def stretched(borders: Borders, factor: float) -> Borders:
    """The same path, `factor` times as slow: whole ticks, rates in proportion."""
    # Borders are rounded to ticks, not durations: nothing adds up, and no piece becomes empty as factor >= 1.
    time = np.rint(np.concatenate(([0], np.cumsum(borders.ticks))) * factor).astype(np.int64)
    return Borders(borders.x, borders.v / factor, np.diff(time))
