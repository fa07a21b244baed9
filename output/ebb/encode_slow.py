"""Slow a motion down where the board needs more time, and only there: the path stays, the time is stretched.

With stretch s at a border (1: as planned) its rate becomes v / s, and a piece lasts T times the mean of its ends' stretches.
The stretch rises and falls so gently around the place that needs it that the change of speed is no steeper than half of what
the motion itself does at its steepest. A piece that is slower at one end than at the other is another cubic, which bends beside
the way planned (`bent`): where it does so too far, the stretch is made to change more gently.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from output.ebb.arithmetic import ONE_STEP
from output.ebb.encode_pieces import Borders, along, extreme_rates, jerks

Array = NDArray[np.float64]

_SHARE = 0.5
# And 1 / stretch changes by this over one piece at most, however slow the motion is there.
_STEEPEST = 0.5


def slowed(borders: Borders, need: Array, rise: Array, begun: float | None = None) -> tuple[Borders, Array]:
    """The motion with piece i `need[i]` (n,) times as long or longer; 1 is as planned. And the stretch at each border (n + 1,).

    Over piece i, 1 / stretch changes by `rise[i]` at most (`rises`). A motion that goes on from one that was `begun` times as
    slow at its end starts so, whatever it needs.
    """
    t = borders.ticks.astype(np.float64)
    stretch = np.ones(len(borders) + 1)
    stretch[:-1] = np.maximum(need, 1.0)
    stretch[1:] = np.maximum(stretch[1:], need)
    if begun is not None:
        stretch[0] = max(stretch[0], begun)
    # In shares of the planned speed the rise is a slope, and no share may lie above such a slope from another, either way.
    share, slope = 1 / stretch, np.concatenate(([0.0], np.cumsum(rise)))
    share = np.minimum.accumulate(share - slope) + slope
    share = np.minimum.accumulate((share + slope)[::-1])[::-1] - slope
    if begun is not None:
        share[0] = 1 / begun
        share = np.maximum.accumulate(share + slope) - slope
    stretch = 1 / np.clip(share, 0.0, 1.0)
    lasts = t * (stretch[:-1] + stretch[1:]) / 2
    ticks = np.rint(lasts).astype(np.int64)
    # Whole ticks first, and the rates after them: a tick too many would be felt as a change of speed.
    rounded = ticks / lasts
    stretch[1:-1] *= (rounded[:-1] + rounded[1:]) / 2
    return Borders(borders.x, borders.v / stretch[:, None], ticks), stretch


def bent(planned: Borders, slower: Borders) -> Array:
    """How far (n,) beside the way planned the slower pieces are, in 2^-31 steps, looked at in three places of each."""
    piece = np.arange(len(planned))
    off = np.zeros(len(planned))
    for share in (0.25, 0.5, 0.75):
        here, way = along(planned, piece, share * planned.ticks.astype(np.float64))
        there, _ = along(slower, piece, share * slower.ticks.astype(np.float64))
        aside = (there - here)[:, 0] * way[:, 1] - (there - here)[:, 1] * way[:, 0]
        off = np.maximum(off, np.abs(aside) / np.maximum(np.hypot(*way.T), 1.0))
    return off


def too_fast(slower: Borders) -> NDArray[np.bool_]:
    """Which pieces (n,) would step faster somewhere than the board can: cubics may, whose ends do not."""
    slowest, fastest = extreme_rates(slower, jerks(slower))
    return np.asarray((np.maximum(-slowest, fastest) > ONE_STEP).any(axis=1))


def slowness(planned: Borders, slower: Borders) -> float:
    """How many times as slow the one is as the other at their end; 1 at a rest."""
    one, two = float(np.hypot(*planned.v[-1])), float(np.hypot(*slower.v[-1]))
    return one / two if two > 0 else 1.0


def rises(borders: Borders) -> Array:
    """How much 1 / stretch may change over each piece (n,): share * A T / |v|, as then |v| d(1 / stretch) = share * A T."""
    t = borders.ticks.astype(np.float64)
    speed = np.hypot(*borders.v.T)
    steepest = float((np.hypot(*np.diff(borders.v, axis=0).T) / t).max(initial=0.0))
    fastest = np.maximum(np.maximum(speed[:-1], speed[1:]), 1.0)
    return np.asarray(np.minimum(_SHARE * steepest * t / fastest, _STEEPEST))
