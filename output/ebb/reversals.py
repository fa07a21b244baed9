"""Backward steps: a motor that steps once against the way it was going and then goes on. The paper shows them as a knot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from output.ebb.arithmetic import ONE_STEP
from output.ebb.replay import MOVE, Rows

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class Reversals:
    """Counts, over rows fed in order, single steps whose neighbours on the same axis in the same motion go the other way."""

    def __init__(self) -> None:
        self.count = 0
        self._open: list[list[int]] = [[], []]

    def add(self, rows: Rows) -> None:
        for axis in (0, 1):
            steps = _signed_steps(rows, axis)
            # A row that is no motion ends what came before: 0 is the separator.
            stops = np.repeat((rows.kind != MOVE) & (rows.ticks > 1), 3)
            keep = (steps != 0) | stops
            self._runs(axis, np.where(stops, 0, steps)[keep])

    def _runs(self, axis: int, steps: Ints) -> None:
        signs = np.concatenate((np.sign(self._open[axis]), np.sign(steps))).astype(np.int64)
        sizes = np.concatenate((self._open[axis], steps)).astype(np.int64)
        if not len(signs):
            return
        starts = np.concatenate(([0], np.flatnonzero(np.diff(signs)) + 1))
        totals = np.add.reduceat(sizes, starts)
        single = (np.abs(totals[1:-1]) == 1) & (totals[:-2] != 0) & (totals[2:] != 0)
        self.count += int(single.sum())
        # The last run may go on, and the one before it is its neighbour; its own case is settled.
        self._open[axis] = totals[-2:].tolist()


def _signed_steps(rows: Rows, axis: int) -> Ints:
    """(3 n,): the steps of each row in up to three parts of one direction each, in order."""
    r0, a, j = (column[:, axis].astype(np.float64) for column in (rows.r0, rows.accel, rows.jerk))
    last = rows.ticks.astype(np.float64)
    v0 = r0 + a / 2 - j / 6
    with np.errstate(divide="ignore", invalid="ignore"):
        under = np.sqrt(a * a - 2 * j * v0)
        q = -(a + np.where(a < 0, -1.0, 1.0) * under)
        roots = np.vstack((2 * v0 / q, q / j))
    roots = np.sort(np.where(np.isfinite(roots) & (roots > 0) & (roots < last), np.rint(roots), 0.0), axis=0)
    before, after = rows.counter[:-1, axis], rows.counter[1:, axis]
    cuts = [before]
    for tick in roots:
        t = tick.astype(np.int64)
        moved = (
            rows.r0[:, axis] * t + rows.accel[:, axis] * (t * (t + 1) // 2) + rows.jerk[:, axis] * ((t - 1) * t * (t + 1) // 6)
        )
        cuts.append(np.where(t > 0, (rows.phase[:, axis] + ONE_STEP // 2 + moved) >> 31, before))
    cuts.append(after)
    return np.asarray(np.diff(np.vstack(cuts), axis=0).T.reshape(-1))
