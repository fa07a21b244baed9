"""The best motion with given borders: one cubic between each two, position and rate continuous, least squares off the plan.

A cubic that takes both ends from the plan is several times further off in between than one whose ends may move a little. So
the positions and rates at the borders are the unknowns, and the squared distance from the plan over time is made least; the
ends of the motion stay where they are. Border p has two unknowns, x_p and v_p, a piece has four, so the normal equations are
banded, three wide either side, and both motors have the same matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from output.ebb.arithmetic import ONE_STEP
from output.ebb.encode_pieces import Borders, extremes, jerks, slack_rate
from planning.motion.late import solveh_banded

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

# Rates are told in units of 2^-31 steps per this many ticks, so that both unknowns are of one size.
_RATE_TICKS = 250.0
# Weight that keeps a border where the plan has it.
_PINNED = 1e9
# A merged piece may accelerate this much more than the plan does at its steepest in the motion.
_STEEPER = 1.25


@dataclass(frozen=True, eq=False)
class Plan:
    """The motion as planned, looked at in `places` of each of its n pieces, which are cubics in between: `tick` (places n,),
    position `x` and rate `v` there.

    `to_mm` (2, 2) turns rows of motor units into millimetres, by which accelerations are compared.
    """

    borders: Borders
    to_mm: Array
    places: int = 3

    @cached_property
    def time(self) -> Ints:
        return np.concatenate(([0], np.cumsum(self.borders.ticks)))

    @cached_property
    def tick(self) -> Array:
        return np.asarray((self.time[:-1, None] + self.borders.ticks[:, None] * self._shares).ravel())

    @property
    def _shares(self) -> Array:
        return np.arange(self.places) / self.places

    @cached_property
    def _there(self) -> tuple[Array, Array]:
        b = self.borders
        whole = b.ticks[:, None, None].astype(np.float64)
        t = whole * self._shares[None, :, None]
        j = jerks(b)[:, None, :]
        v0, v1 = b.v[:-1, None, :], b.v[1:, None, :]
        a = (v1 - v0) / whole - j * whole / 2
        x = b.x[:-1, None, :] + t * (v0 + t * (a / 2 + t * j / 6))
        return x.reshape(-1, 2), (v0 + t * (a + t * j / 2)).reshape(-1, 2)

    @property
    def x(self) -> Array:
        return self._there[0]

    @property
    def v(self) -> Array:
        return self._there[1]

    @cached_property
    def steepest(self) -> float:
        """The greatest acceleration at any border, in mm per tick^2."""
        return float(np.hypot(*(np.vstack(_end_accelerations(self.borders)) @ self.to_mm).T).max())


@dataclass(frozen=True, eq=False, slots=True)
class Fit:
    """`borders` of the fitted motion, how far each of its pieces is `off` the plan at most (2^-31 steps), and which are `bad`
    for another reason: they accelerate much more than the plan does, or turn an axis back that the plan does not turn."""

    borders: Borders
    off: Array
    bad: Flags


def fit(plan: Plan, kept: Ints, pinned: Flags) -> Fit:
    """The best cubics between the plan's borders `kept` (k + 1,); where `pinned` (k + 1,) they are the plan's own."""
    b = plan.borders
    ticks = np.diff(plan.time[kept])
    count = plan.places * np.diff(kept)
    first = plan.places * kept[:-1]
    piece = np.repeat(np.arange(len(ticks)), count)
    long = ticks[piece].astype(np.float64)
    u = (plan.tick - plan.time[kept[:-1]][piece]) / long
    scale = long / _RATE_TICKS
    basis = np.stack(
        (u * u * (2 * u - 3) + 1, u * (u - 1) * (u - 1) * scale, u * u * (3 - 2 * u), u * u * (u - 1) * scale), axis=1
    )
    x, v = b.x[kept], b.v[kept] * _RATE_TICKS
    own = np.stack((x[:-1], v[:-1], x[1:], v[1:]), axis=1)
    residual = plan.x - np.einsum("ia,iac->ic", basis, own[piece])
    weight = np.repeat(b.ticks / float(plan.places), plan.places)
    moved = _solved(basis, residual, weight, first, pinned)
    x, v = x + moved[0::2], v + moved[1::2]
    change = np.stack((moved[0:-2:2], moved[1:-2:2], moved[2::2], moved[3::2]), axis=1)
    off = np.abs(residual - np.einsum("ia,iac->ic", basis, change[piece])).max(axis=1)
    fitted = Borders(x, v / _RATE_TICKS, ticks)
    return Fit(fitted, np.maximum.reduceat(off, first), _bad(plan, fitted, kept))


def _solved(basis: Array, residual: Array, weight: Array, first: Ints, pinned: Flags) -> Array:
    """The unknowns (2 (k + 1), 2): changes of position and rate at each border."""
    n = len(first) + 1
    band = np.zeros((4, 2 * n))
    right = np.zeros((2 * n, 2))
    weighted = basis * weight[:, None]
    for a in range(4):
        place = slice(a, a + 2 * (n - 1), 2)
        right[place] += np.add.reduceat(weighted[:, a, None] * residual, first)
        for c in range(a, 4):
            band[c - a, place] += np.add.reduceat(weighted[:, c] * basis[:, a], first)
    held = np.repeat(pinned, 2)
    band[0] += np.where(held, _PINNED * band[0].max(), 1e-9 * band[0].max())
    return np.asarray(solveh_banded(band, right, lower=True, overwrite_ab=True, overwrite_b=True, check_finite=False))


def _end_accelerations(borders: Borders) -> tuple[Array, Array]:
    t = borders.ticks[:, None].astype(np.float64)
    mean = np.diff(borders.x, axis=0) / t
    v0, v1 = borders.v[:-1], borders.v[1:]
    return (6 * mean - 4 * v0 - 2 * v1) / t, (4 * v1 + 2 * v0 - 6 * mean) / t


def _bad(plan: Plan, fitted: Borders, kept: Ints) -> Flags:
    starts, ends = _end_accelerations(fitted)
    steep = (plan.steepest * _STEEPER) ** 2
    bad = np.maximum(_squares(starts @ plan.to_mm), _squares(ends @ plan.to_mm)) > steep
    low = np.minimum(np.minimum.reduceat(plan.v, plan.places * kept[:-1]), plan.borders.v[kept[1:]])
    high = np.maximum(np.maximum.reduceat(plan.v, plan.places * kept[:-1]), plan.borders.v[kept[1:]])
    t = fitted.ticks[:, None].astype(np.float64)
    slowest, fastest = extremes(fitted.v[:-1], starts, (ends - starts) / t, t)
    # A small dip is held back when it is quantised; more would be a turn.
    slack = slack_rate(np.maximum(np.abs(low), np.abs(high)), t)
    bad |= (((low >= -slack) & (slowest < -slack)) | ((high <= slack) & (fastest > slack))).any(axis=1)
    # Nor may a motor that is near the board's fastest be told to go faster.
    return np.asarray(bad | (np.maximum(-slowest, fastest) > np.maximum(ONE_STEP, np.maximum(-low, high))).any(axis=1))


def _squares(vectors: Array) -> Array:
    return np.asarray((vectors * vectors).sum(axis=1))
