"""Where to cut a motion for commands that know no jerk, or no acceleration: long, but not shorter than the board sustains.

The motion is sampled finely; from each place on, the longest span is taken over which a parabola (LT, LM) or a straight line
(SM, XM) with the right ends stays within the tolerance, and never less than what the board can be told in the time. Where even
that is further off than it may be, the caller slows the motion down.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from output.ebb.encode_pieces import Borders, along

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_LOOKED_AT = 5


@dataclass(frozen=True, eq=False, slots=True)
class Samples:
    """Positions `x` and rates `v` (n + 1, 2) at whole `ticks` (n + 1,) from the motion's start, close together."""

    ticks: Ints
    x: Array
    v: Array


def sampled(borders: Borders, every_ticks: int, turns: bool) -> Samples:
    """Sample every `every_ticks` or a little less; with `turns` also where an axis turns back, to the nearest tick."""
    time = np.concatenate(([0], np.cumsum(borders.ticks)))
    total = int(time[-1])
    at = np.arange(0, total, every_ticks, dtype=np.int64)
    if turns:
        x, v = _at(borders, time, np.append(at, total).astype(np.float64))
        crossing = np.flatnonzero((v[:-1] * v[1:] < 0).any(axis=1))
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(v[crossing] * v[crossing + 1] < 0, v[crossing] / (v[crossing] - v[crossing + 1]), 0.0)
        places = at[crossing][:, None] + share * (np.append(at, total)[crossing + 1] - at[crossing])[:, None]
        at = np.union1d(at, np.rint(places[share > 0]).astype(np.int64))
    at = np.unique(np.append(at[at < total], total))
    x, v = _at(borders, time, at.astype(np.float64))
    return Samples(at, x, v)


def on_milliseconds(borders: Borders, ticks_per_ms: int) -> Samples:
    """Samples at every whole millisecond of the motion, which is slowed down to a whole number of them."""
    time = np.concatenate(([0], np.cumsum(borders.ticks)))
    total = int(time[-1])
    whole_ms = max(-(-total // ticks_per_ms), 1)
    slower = whole_ms * ticks_per_ms / total
    at = np.arange(whole_ms + 1, dtype=np.int64) * ticks_per_ms
    x, v = _at(borders, time, np.minimum(at / slower, total))
    return Samples(at, x, v / slower)


def _at(borders: Borders, time: Ints, tick: Array) -> tuple[Array, Array]:
    piece = np.clip(np.searchsorted(time, tick, side="right") - 1, 0, len(borders) - 1)
    x, v = along(borders, piece, tick - time[piece])
    last = tick >= time[-1]
    x[last], v[last] = borders.x[-1], borders.v[-1]
    return x, v


@dataclass(frozen=True, eq=False, slots=True)
class Spans:
    """Cuts (indices of samples, k + 1) and how far the worst span is off, in 2^-31 steps."""

    cuts: Ints
    worst: float


def cut(samples: Samples, order: int, tolerance: float, least_ticks: int, most_ticks: int, one_way: bool) -> Spans:
    """Spans for parabolas (`order` 2) or lines (1). `one_way`: no parabola may turn an axis back, old firmware cannot."""
    n = len(samples.ticks) - 1
    best = np.zeros(n, dtype=np.int64)
    off_best = np.zeros(n)
    misses = 0
    for m in _lengths(samples, most_ticks):
        starts = np.arange(n - m + 1)
        lasts = samples.ticks[m:] - samples.ticks[:-m]
        off, turns = _off(samples, starts, m, order, one_way)
        fits = (off <= tolerance) & ~turns & (lasts <= most_ticks)
        ends = samples.ticks[starts + m] == samples.ticks[-1]
        # The first that is long enough has to do, whatever it costs; a longer one only when it fits. The last may be short:
        # after it the pen rests.
        take = (fits | (best[starts] == 0)) & ((lasts >= least_ticks) | ends)
        best[starts[take]] = m
        off_best[starts[take]] = off[take]
        # Errors grow with the length: when nothing has fitted for a while, nothing will.
        misses = 0 if fits.any() else misses + 1
        if misses > 3 and best.all():
            break
    best = np.maximum(best, 1)
    cuts, at, worst, lengths = [0], 0, 0.0, best.tolist()
    while at < n:
        worst = max(worst, float(off_best[at]))
        at += lengths[at]
        cuts.append(at)
    return Spans(np.array(cuts), worst)


def without_short_end(samples: Samples, spans: Spans, least_ticks: int) -> list[int]:
    """The cuts, the last two spans made even or one where the last is too short for a motion that goes on after it."""
    cuts: list[int] = spans.cuts.tolist()
    ticks = samples.ticks[cuts]
    if len(cuts) < 3 or ticks[-1] - ticks[-2] >= least_ticks:
        return cuts
    middle = int(np.searchsorted(samples.ticks, (ticks[-3] + ticks[-1]) / 2))
    enough = min(samples.ticks[middle] - ticks[-3], ticks[-1] - samples.ticks[middle]) >= least_ticks
    return [*cuts[:-2], *([middle] if enough else []), cuts[-1]]


def _lengths(samples: Samples, most_ticks: int) -> list[int]:
    """How many samples a span may have: all small numbers, then about an eighth more each time."""
    n = len(samples.ticks) - 1
    most = max(1, min(n, round(most_ticks / max(float(np.median(np.diff(samples.ticks))), 1.0)) + 2))
    lengths, m = [], 1
    while m <= most:
        lengths.append(m)
        m = max(m + 1, round(m * 1.125))
    return lengths


def _off(samples: Samples, starts: Ints, m: int, order: int, one_way: bool) -> tuple[Array, NDArray[np.bool_]]:
    """How far the fit over m samples is off at most, and whether it turns back."""
    t = (samples.ticks[starts + m] - samples.ticks[starts])[:, None].astype(np.float64)
    x0, x1 = samples.x[starts], samples.x[starts + m]
    v0, v1 = samples.v[starts], samples.v[starts + m]
    mean = (x1 - x0) / t
    a = (v1 - v0) / t if order == 2 else np.zeros_like(mean)
    first = mean - a * t / 2
    off = np.zeros(len(starts))
    for inner in sorted({round(k * m / _LOOKED_AT) for k in range(1, _LOOKED_AT)} - {0, m}):
        s = (samples.ticks[starts + inner] - samples.ticks[starts])[:, None]
        fit = x0 + s * (first + s * a / 2)
        off = np.maximum(off, np.abs(fit - samples.x[starts + inner]).max(axis=1))
    if m == 1:
        # Nothing was looked at in between: the error of the middle by the change of rate.
        bend = np.abs(v1 - v0) if order == 1 else np.abs(v0 + v1 - 2 * mean)
        off = (bend * t / 8).max(axis=1)
    if not one_way or order == 1:
        return off, np.zeros(len(starts), dtype=np.bool_)
    last = mean + a * t / 2
    turns = first * last < 0
    # An axis that may not turn back stays where it would have gone on to: this far off.
    beyond = np.where(turns, np.minimum(np.abs(first), np.abs(last)) ** 2 / np.maximum(2 * np.abs(a), 1e-9), 0.0)
    return np.maximum(off, beyond.max(axis=1)), np.asarray(turns.any(axis=1))
