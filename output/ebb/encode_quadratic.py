"""LT and LM from spans: constant acceleration, solved from the counters and accumulators that the board will really have.

Along the way of an axis (`sign`), the accumulator has to gain what is missing from where it is to the target, half a step up.
Firmware 3 keeps one signed phase for both ways; 2.x counts magnitudes, so that a motor that turns back finds the fraction of a
step mirrored: counting from the true accumulator makes good for that within one piece.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from output.ebb.arithmetic import ONE_STEP, TICKS_PER_MS, trunc_div
from output.ebb.commands import LM, LT, SM, Command
from output.ebb.encode_pieces import PRIMED

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class AxisPiece:
    """One axis of one command: its direction, Rate and Accel as magnitudes, and how many steps it takes in the time."""

    sign: int
    rate: int
    accel: int
    steps: int


STANDING = AxisPiece(1, 0, 0, 0)


def timed(ticks: int, one: AxisPiece, two: AxisPiece, old: bool) -> Command | None:
    """The LT of both axes, or a wait of whole milliseconds when neither moves (old firmware refuses such an LT)."""
    if old and not one.rate and not two.rate:
        return wait(ticks)
    # Firmware 3 signs Rate and Accel; 2.x takes only the direction from Rate and adds Accel to the magnitude.
    accels = [p.accel if old else p.sign * p.accel for p in (one, two)]
    return LT(ticks, one.sign * one.rate, accels[0], two.sign * two.rate, accels[1])


def counted(ticks: int, one: AxisPiece, two: AxisPiece) -> Command | None:
    """The LM of both axes, each with the steps that it would take in the time."""
    parts = [(p.rate, p.sign * p.steps, p.accel) if p.steps else (0, 0, 0) for p in (one, two)]
    if not one.steps and not two.steps:
        return wait(ticks)
    return LM(*parts[0], *parts[1])


def wait(ticks: int) -> Command | None:
    """A delay of so many ticks, in whole milliseconds; None when that is none."""
    return SM(ticks // TICKS_PER_MS, 0, 0) if ticks >= TICKS_PER_MS else None


def axis_piece(
    position: int, acc: int, ticks: int, start: float, target: float, change: float, *, old: bool, final: bool
) -> AxisPiece:
    """One axis from counter `position` and accumulator `acc` to `target` (2^-31 steps) in `ticks`, faster by `change`.

    The plan has it at `start` now: the way from there is the piece's direction, whatever the rates at its ends are. A `final`
    one ends on the rounded target's step for certain.
    """
    sign = 1 if target > start else -1
    gain = _gain(sign, position, acc, target, old)
    if final:
        missing = int(np.rint(target / ONE_STEP)) - position
        if missing and (gain <= 0 or sign * missing < 0):
            sign = 1 if missing > 0 else -1
            gain = _gain(sign, position, acc, target, old)
    if gain <= 0:
        return STANDING
    accel, first = _solve(ticks, gain, sign * change)
    total = first * ticks + accel * (ticks * (ticks + 1) // 2)
    from_here = acc if old or sign > 0 else ONE_STEP - 1 - acc
    return AxisPiece(sign, first + trunc_div(accel, 2), accel, (from_here + total) // ONE_STEP)


def _gain(sign: int, position: int, acc: int, target: float, old: bool) -> int:
    if old:
        return sign * round(target) + PRIMED - (sign * position * ONE_STEP + acc)
    return sign * (round(target) + PRIMED - (position * ONE_STEP + acc))


def _solve(ticks: int, gain: int, change: float) -> tuple[int, int]:
    """Accel and the rate before tick 1 that gain `gain` > 0 in `ticks`, with no tick's rate below 0 and Rate above 0."""
    pairs = ticks * (ticks + 1) // 2
    accel = round(change / ticks)
    if accel > 0:
        # At most the acceleration that starts from Rate 1.
        accel = min(accel, max((gain - ticks) // (pairs - ticks // 2), 0))
    elif accel < 0 and ticks > 1:
        # At most the one that ends at rate 0.
        accel = max(accel, -(gain // (ticks * ticks - pairs)))
    first = (2 * (gain - accel * pairs) + ticks) // (2 * ticks)
    low = max(1 - trunc_div(accel, 2), -accel, -accel * ticks)
    # Neither a tick's rate nor Rate, half an acceleration before the first, may be beyond the register.
    high = ONE_STEP - 1 - max(trunc_div(accel, 2), accel * ticks)
    return accel, min(max(first, low), high)
