"""A motion as the board's integers: cubic pieces in accumulator units, quantised so that no error is ever left behind.

Units: positions in 2^-31 steps, times in ticks of 40 us, rates in 2^-31 steps per tick (2^31 is 25 kHz). The board's phase
`position * 2^31 + acc` starts half a step up (`PRIMED`), so that its whole part is the plan's position rounded to the nearest.

Laws (tests/laws/test_encode_laws.py):
- each piece's rate is solved from the phase that the board will really have, so that rounding errors do not add up;
- at a motion's end the whole part of the phase is the rounded end of the plan, with EDGE of a step to spare;
- where the plan moves an axis one way, the rate register never has the other sign.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from output.ebb.arithmetic import ONE_STEP, TICK_S
from output.errors import BadCommand
from planning.motion.limits import Kinematics
from planning.motion.plan import Motion

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

# The phase at rest on a whole step: half a step up, by which rounding down becomes rounding to the nearest.
PRIMED = ONE_STEP // 2
# A motion ends at least this far (in steps) from where the rounded position would change.
EDGE = 1 / 16
# How far (steps) the middle of a piece may be off because jerk and acceleration are integers; longer pieces are split.
_MIDDLE_ERROR = 0.1
# How far (2^-31 steps) a slow piece's end may be off when its rate is held back so as not to step backwards.
_END_ERROR = ONE_STEP / 64
# Steps per tick: rates this close (3 steps per second) are the same when halves of a ramp are told.
_PAIR_RATE = 1.2e-4
# Ticks: a piece of this length that is held back so ends at most 1/64 of a step off.
_LONGEST_AT_REST = 900.0
# No command lasts longer (0.25 s), however straight and steady the motion: a pause waits for what is on the board, and a kill
# leaves it to be drawn.
LONGEST_TICKS = 6250
# A rate this much (of the piece's greatest) the wrong way is the rounding of a piece that goes one way, and is held back, which
# may move the end of the piece by this much (steps) at most.
_SLACK = 2e-3
_HELD_BACK = 1 / 32
# Ticks over which an error of the phase is made good when the pieces are shorter.
_SETTLING = 250
# Pieces that are worked on at a time: arrays are quick, but Python's integers take room.
_WINDOW = 1 << 15
# Rates below this (2^-31 steps per tick) are standing still: 1e-5 steps per second.
STILL_RATE = 1.0


@dataclass(frozen=True, eq=False, slots=True)
class Borders:
    """Where the pieces of a motion meet: `x` (n + 1, 2) positions and `v` (n + 1, 2) rates there, `ticks` (n,) between them.

    A piece is the cubic with these ends.
    """

    x: Array
    v: Array
    ticks: Ints

    def __len__(self) -> int:
        return len(self.ticks)


class Cubics(NamedTuple):
    """Per piece, as integers: accel and jerk (n, 2) as the board gets them, the least and greatest Rate (n, 2) allowed for each
    axis, and `base` (n, 2), how far accel and jerk alone move it. `way` (n, 2): 1 when the plan only moves the axis forwards
    during the piece, -1 backwards, 0 both, 2 when it rests. `slow` (n, 2): so slowly that integers hardly resolve its curve."""

    accel: Ints
    jerk: Ints
    least: Ints
    most: Ints
    base: Ints
    way: Ints
    slow: NDArray[np.bool_]


def borders_of(
    motion: Motion, kinematics: Kinematics, origin_mm: Array, reached: Array | None = None, last: bool = True
) -> Borders:
    """The motion's borders, its ends moved into the middle 7/8 of their step so that they round to one step for certain.

    Only where it rests: a part of a stroke goes on from `reached` (2,), where the one before ended in 2^-31 steps, and one that
    is not the `last` ends where the plan has it.
    """
    ticks = np.maximum(np.rint(motion.duration_s / TICK_S).astype(np.int64), 1)
    points_mm = np.vstack((motion.position_mm, motion.end_mm[None, :]))
    velocity_mm_s = np.vstack((motion.velocity_mm_s, np.zeros((1, 2)) if last else motion.ends()[1][-1:]))
    x = kinematics.steps(points_mm - origin_mm)
    v = kinematics.steps(velocity_mm_s) * TICK_S
    way = np.vstack((np.zeros((1, 2)), np.cumsum(np.abs(np.diff(x, axis=0)), axis=0)))
    shift_start = settled(x[0]) - x[0] if reached is None else reached / ONE_STEP - x[0]
    # A part that hardly moves an axis leaves it as much beside its place as it found it.
    shift_end = settled(x[-1]) - x[-1] if last else np.where(way[-1] > 1.0, 0.0, shift_start)
    if shift_start.any() or shift_end.any():
        # Spread the shift over the way that the axis goes: its velocity is scaled a little and keeps its sign.
        total = np.where(way[-1] > 0, way[-1], 1.0)
        slope = np.where(way[-1] > 0, shift_end - shift_start, 0.0) / total
        if reached is not None and last:
            late = np.where(way[-1] > 1.0, 0.0, shift_end - shift_start)
            slope = np.where(way[-1] > 1.0, slope, 0.0)
            x, v = _over_time(x, v, ticks, late)
        x = x + shift_start + slope * way
        v = v + slope * np.abs(v)
    return Borders(x * ONE_STEP, v * ONE_STEP, ticks)


def _over_time(x: Array, v: Array, ticks: Ints, shift: Array) -> tuple[Array, Array]:
    """Positions and rates with `shift` (2,) added smoothly from 0 at the first to all of it at the last."""
    time = np.concatenate(([0], np.cumsum(ticks)))[:, None]
    u = time / time[-1]
    return x + shift * u * u * (3 - 2 * u), v + shift * 6 * u * (1 - u) / time[-1]


def begun_at(borders: Borders, rate: Array, ticks: int) -> Borders:
    """The motion, begun at `rate` (2,) and as it was after `ticks`; meanwhile it is moved by up to 4/27 of what the difference
    of the rates makes in that time."""
    time = np.concatenate(([0], np.cumsum(borders.ticks)))[:, None]
    u = np.minimum(time / min(ticks, time[-1, 0]), 1.0)
    change = rate - borders.v[0]
    return Borders(borders.x + change * time * (1 - u) ** 2, borders.v + change * (1 - u) * (1 - 3 * u), borders.ticks)


def settled(steps: Array) -> Array:
    """Positions (steps) moved by at most EDGE so that they are at least EDGE from where rounding changes."""
    nearest = np.rint(steps)
    return np.clip(steps, nearest - 0.5 + EDGE, nearest + 0.5 - EDGE)


def jerks(borders: Borders) -> Array:
    """The jerk (n, 2) of the cubics between the borders."""
    t = borders.ticks[:, None].astype(np.float64)
    return 6.0 * (borders.v[1:] + borders.v[:-1]) / t**2 - 12.0 * np.diff(borders.x, axis=0) / t**3


def split(borders: Borders) -> Borders:
    """Split pieces that are longer than LONGEST_TICKS, or so long that integer jerk and acceleration would move their middle by
    more than a tenth of a step.

    With both end points and both end rates kept, an error d of the jerk moves the middle by 0.008 d T^3, one of the
    acceleration by d T^2 / 8.
    """
    t = borders.ticks.astype(np.float64)
    j = jerks(borders)
    off = np.abs(j - np.rint(j)).max(axis=1)
    middle = (0.00802 * off * t**3 + 0.0625 * t**2 * (off > 0)) / ONE_STEP
    parts = np.maximum(np.ceil(np.cbrt(middle / _MIDDLE_ERROR)), np.ceil(t / LONGEST_TICKS))
    # Next to a standstill the rate may not go below zero, which costs the end up to d T^3 / 12: shorter pieces there.
    rests = (np.minimum(np.abs(borders.v[:-1]), np.abs(borders.v[1:])) <= t[:, None] ** 2 / 12).any(axis=1) & (off > 0)
    parts = np.maximum(parts, np.where(rests, np.ceil(t / _LONGEST_AT_REST), 1.0)).astype(np.int64)
    parts = np.clip(parts, 1, borders.ticks)
    if (parts == 1).all():
        return borders
    return subdivide(borders, parts)


def subdivide(borders: Borders, parts: Ints) -> Borders:
    """Cut piece i into `parts[i]` pieces of nearly equal length along the same cubic."""
    owner = np.repeat(np.arange(len(parts)), parts)
    index = np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)
    begin = borders.ticks[owner] * index // parts[owner]
    end = borders.ticks[owner] * (index + 1) // parts[owner]
    x, v = along(borders, owner, begin.astype(np.float64))
    return Borders(np.vstack((x, borders.x[-1:])), np.vstack((v, borders.v[-1:])), end - begin)


def stretched(borders: Borders, factor: float) -> Borders:
    """The same path, `factor` times as slow: whole ticks, rates in proportion."""
    # Borders are rounded to ticks, not durations: nothing adds up, and no piece becomes empty as factor >= 1.
    time = np.rint(np.concatenate(([0], np.cumsum(borders.ticks))) * factor).astype(np.int64)
    return Borders(borders.x, borders.v / factor, np.diff(time))


def along(borders: Borders, piece: Ints, tick: Array) -> tuple[Array, Array]:
    """Position and rate (m, 2) at `tick` (m,) ticks into each of the pieces `piece` (m,)."""
    j = jerks(borders)[piece]
    t, whole = tick[:, None], borders.ticks[piece][:, None].astype(np.float64)
    v0, v1 = borders.v[piece], borders.v[piece + 1]
    a = (v1 - v0) / whole - j * whole / 2
    return borders.x[piece] + t * (v0 + t * (a / 2 + t * j / 6)), v0 + t * (a + t * j / 2)


def cubics_of(borders: Borders) -> Cubics:
    """Integer accelerations and jerks, and the rates that keep the direction and the board's 25 kHz.

    Raises BadCommand when a motor would have to step faster than 25 kHz.
    """
    ticks = borders.ticks[:, None]
    t = ticks.astype(np.float64)
    v0, v1 = borders.v[:-1], borders.v[1:]
    exact_jerk = jerks(borders)
    jerk = np.rint(exact_jerk).astype(np.int64)
    # Not the exact acceleration but the one that, with this jerk, reaches the end's rate: what is left is tiny and symmetric.
    accel = np.rint((v1 - v0) / t - jerk * t / 2).astype(np.int64)

    jerk, accel = _paired(borders, exact_jerk, jerk, accel)

    slowest, fastest = extreme_rates(borders, exact_jerk)
    if max(fastest.max(initial=0.0), -slowest.min(initial=0.0)) > ONE_STEP * 1.0000001:
        speed = max(fastest.max(), -slowest.min()) / ONE_STEP / TICK_S
        raise BadCommand(f"a motor would have to step at {speed:.0f} Hz, the board steps at most at 25000 Hz; plan slower")
    slack = slack_rate(np.maximum(-slowest, fastest), t)
    forwards, backwards = slowest >= -slack, fastest <= slack
    still = (slowest >= -STILL_RATE) & (fastest <= STILL_RATE)
    accel, jerk = np.where(still, 0, accel), np.where(still, 0, jerk)

    low, high = _register_extremes(accel, jerk, ticks)
    least = np.where(forwards, -low, -ONE_STEP - low)
    most = np.where(backwards, -high, ONE_STEP - 1 - high)
    way = np.where(still, 2, forwards.astype(np.int64) - backwards.astype(np.int64))
    slow = np.maximum(np.abs(v0), np.abs(v1)) <= 2 * t**2
    base = accel * (ticks * (ticks + 1) // 2) + jerk * ((ticks - 1) * ticks * (ticks + 1) // 6)
    return Cubics(accel, jerk, least, most, base - (_truncated(accel, 2) - _truncated(jerk, 6)) * ticks, way, slow)


def slack_rate(fastest: Array, ticks: Array) -> Array:
    """The rate (n, 2) the wrong way that is held back in pieces of `ticks` (n, 1) with these greatest rates."""
    return np.asarray(np.maximum(STILL_RATE, np.minimum(_SLACK * fastest, _HELD_BACK * ONE_STEP / ticks)))


def _paired(borders: Borders, exact_jerk: Array, jerk: Ints, accel: Ints) -> tuple[Ints, Ints]:
    """Where two pieces are the halves of a ramp, from acceleration 0 and back to it, make them so to the last bit: one TD."""
    t = borders.ticks.astype(np.float64)
    if len(t) < 2:
        return jerk, accel
    start = np.abs((borders.v[1:] - borders.v[:-1]) / t[:, None] - exact_jerk * t[:, None] / 2)
    close = np.abs(exact_jerk[:-1] + exact_jerk[1:]) <= 1e-3 * np.abs(exact_jerk[:-1]) + 1.0
    halves = close.all(axis=1) & (t[:-1] == t[1:]) & (start[:-1] * t[:-1, None] <= 2 * ONE_STEP * _PAIR_RATE).all(axis=1)
    halves &= (t[:-1] <= _LONGEST_AT_REST) & np.abs(jerk[:-1]).any(axis=1)
    # Not the second half of one as the first of another.
    first = np.flatnonzero(halves)
    first = first[np.concatenate(([True], np.diff(first) > 1))] if len(first) else first
    whole = np.rint((exact_jerk[first] - exact_jerk[first + 1]) / 2).astype(np.int64)
    jerk[first], jerk[first + 1] = whole, -whole
    accel[first] = 0
    span = t[first + 1][:, None]
    accel[first + 1] = np.rint((borders.v[first + 2] - borders.v[first + 1]) / span + whole * span / 2).astype(np.int64)
    return jerk, accel


def extreme_rates(borders: Borders, jerk: Array) -> tuple[Array, Array]:
    """Least and greatest rate (n, 2) of each piece, whose `jerk` (n, 2) is that of `jerks`."""
    t = borders.ticks[:, None].astype(np.float64)
    return extremes(borders.v[:-1], (borders.v[1:] - borders.v[:-1]) / t - jerk * t / 2, jerk, t)


def extremes(v0: Array, a: Array, j: Array, t: Array) -> tuple[Array, Array]:
    """Least and greatest rate of each cubic."""
    v1 = v0 + t * (a + t * j / 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = np.where(j != 0, -a / j, 0.0)
    turn = np.where((turn > 0) & (turn < t), turn, 0.0)
    middle = v0 + turn * (a + turn * j / 2)
    return np.minimum(np.minimum(v0, v1), middle), np.maximum(np.maximum(v0, v1), middle)


def _truncated(value: Ints, divisor: int) -> Ints:
    return np.asarray(np.sign(value) * (np.abs(value) // divisor))


def _register_extremes(accel: Ints, jerk: Ints, ticks: Ints) -> tuple[Ints, Ints]:
    """Least and greatest of rate(t) - R over the ticks."""
    bias = _truncated(jerk, 6) - _truncated(accel, 2)

    def rate(t: Ints) -> Ints:
        return bias + accel * t + jerk * (t * (t - 1) // 2)

    first, last = rate(np.ones_like(ticks)), rate(ticks)
    low, high = np.minimum(first, last), np.maximum(first, last)
    turn = np.where(jerk != 0, _truncated(jerk - 2 * accel, 2) // np.where(jerk != 0, jerk, 1), 1)
    for shift in (-1, 0, 1):
        at = rate(np.clip(turn + shift, 1, ticks))
        low, high = np.minimum(low, at), np.maximum(high, at)
    return low, high


@dataclass(slots=True)
class Phase:
    """Both motors' `position * 2^31 + acc`, as the board will have it after what was encoded so far."""

    axis1: int
    axis2: int

    @property
    def steps(self) -> tuple[int, int]:
        return self.axis1 >> 31, self.axis2 >> 31


Parameters = tuple[int, int, int, int, int, int, int]


def quantised(borders: Borders, phase: Phase) -> Iterator[Parameters]:
    """Intervals, Rate, Accel and Jerk of both axes for each piece; `phase` is moved on to what the board will have."""
    for first in range(0, len(borders), _WINDOW):
        last = min(first + _WINDOW, len(borders))
        window = Borders(borders.x[first : last + 1], borders.v[first : last + 1], borders.ticks[first:last])
        cubics = cubics_of(window)
        targets = np.rint(window.x).astype(np.int64) + PRIMED
        ticks = window.ticks.tolist()
        rate1, accel1, jerk1, phase.axis1 = _one_axis(ticks, cubics, targets, 0, phase.axis1)
        rate2, accel2, jerk2, phase.axis2 = _one_axis(ticks, cubics, targets, 1, phase.axis2)
        yield from zip(ticks, rate1, accel1, jerk1, rate2, accel2, jerk2, strict=True)


def _one_axis(
    ticks: list[int], cubics: Cubics, targets: Ints, axis: int, phase: int
) -> tuple[list[int], list[int], list[int], int]:
    accels, jerks_, rates = cubics.accel[:, axis].tolist(), cubics.jerk[:, axis].tolist(), []
    rows = zip(
        ticks,
        cubics.base[:, axis].tolist(),
        cubics.least[:, axis].tolist(),
        cubics.most[:, axis].tolist(),
        targets[:-1, axis].tolist(),
        targets[1:, axis].tolist(),
        cubics.way[:, axis].tolist(),
        cubics.slow[:, axis].tolist(),
        strict=True,
    )
    for i, (t, base, least, most, start, target, way, slow) in enumerate(rows):
        if way == 2:
            rates.append(0)
            continue
        if t < _SETTLING:
            # What is off is not made good at once, which would be a jolt, but at the pace of longer pieces.
            target += (phase - start) * (_SETTLING - t) // _SETTLING
        rate = (2 * (target - phase - base) + t) // (2 * t)
        if rate < least or rate > most:
            rate = least if rate < least else most
            if slow and way and abs(phase + rate * t + base - target) > _END_ERROR:
                # Held back time and again, it would drift: go evenly instead.
                accels[i] = jerks_[i] = base = 0
                even = (2 * (target - phase) + t) // (2 * t)
                rate = max(even, 0) if way > 0 else min(even, 0)
        rates.append(rate)
        phase += rate * t + base
    return rates, accels, jerks_, phase
