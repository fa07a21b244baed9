"""Slow a motion down where the board needs more time, and only there: the path stays, the time is stretched.

With stretch s at a border (1: as planned) its rate becomes v / s, and a piece lasts T times the mean of its ends' stretches.
The stretch rises and falls so gently around the place that needs it that the change of speed is no steeper than half of what
the motion itself does at its steepest. A piece that is slower at one end than at the other is another cubic, which bends beside
the way planned; a long one is cut in two until it does not (`bent`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from output.ebb.encode_pieces import Borders, along

Array = NDArray[np.float64]

_SHARE = 0.5
# And over one piece the stretch falls to 1 / (1 + this) at most, however slow the motion is there.
_STEEPEST = 0.5


def slowed(borders: Borders, need: Array, begun: float | None = None) -> Borders:
    """The motion with piece i `need[i]` (n,) times as long or longer; 1 is as planned.

    A motion that goes on from one that was `begun` times as slow at its end starts so, whatever it needs.
    """
    t = borders.ticks.astype(np.float64)
    stretch = np.ones(len(borders) + 1)
    stretch[:-1] = np.maximum(need, 1.0)
    stretch[1:] = np.maximum(stretch[1:], need)
    rise = _rises(borders, t).tolist()
    if begun is not None:
        stretch[0] = max(stretch[0], begun)
    level = stretch.tolist()
    for i, up in enumerate(rise):
        level[i + 1] = max(level[i + 1], level[i] / (1 + up * level[i]))
    for i in range(len(rise) - 1, -1, -1):
        level[i] = max(level[i], level[i + 1] / (1 + rise[i] * level[i + 1]))
    if begun is not None:
        level[0] = begun
        for i, up in enumerate(rise):
            fall = 1 - up * level[i]
            level[i + 1] = min(level[i + 1], level[i] / fall) if fall > 0 else level[i + 1]
    stretch = np.array(level)
    ticks = np.rint(t * (stretch[:-1] + stretch[1:]) / 2).astype(np.int64)
    # Whole ticks first, and the rates after them: a tick too many would be felt as a change of speed.
    longer = ticks / t
    stretch[1:-1] = (longer[:-1] + longer[1:]) / 2
    return Borders(borders.x, borders.v / stretch[:, None], ticks)


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


def slowness(planned: Borders, slower: Borders) -> float:
    """How many times as slow the one is as the other at their end; 1 at a rest."""
    one, two = float(np.hypot(*planned.v[-1])), float(np.hypot(*slower.v[-1]))
    return one / two if two > 0 else 1.0


def _rises(borders: Borders, t: Array) -> Array:
    """How much the stretch s may change over each piece, over s^2: share * A T / |v|, as dv = |v| ds / s^2 = share * A T."""
    speed = np.hypot(*borders.v.T)
    steepest = float((np.hypot(*np.diff(borders.v, axis=0).T) / t).max(initial=0.0))
    fastest = np.maximum(np.maximum(speed[:-1], speed[1:]), 1.0)
    return np.asarray(np.minimum(_SHARE * steepest * t / fastest, _STEEPEST))
