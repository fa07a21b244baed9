"""The step interrupt's arithmetic, tick by tick or in closed form, exact in integers.

Every 40 us and for each axis: Accel += Jerk; Rate += Accel; acc += Rate, all 32-bit registers that wrap. When bit 31 of acc
is set it is cleared and the motor steps, backwards if Rate is negative at that tick. With F = acc + the sum of the rates this
is: position change = floor(F / 2^31), acc = F mod 2^31, for any int32 rates.

Clock: ticks since the command was loaded; the load tick itself is tick 0 and takes no step.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

ONE_STEP = 1 << 31
PHASE_MASK = ONE_STEP - 1
TICKS_PER_S = 25_000

_CHUNK = 1 << 16


def int32(value: int) -> int:
    """`value` as a 32-bit register holds it."""
    return ((value + ONE_STEP) & 0xFFFFFFFF) - ONE_STEP


def c_divide(value: int, divisor: int) -> int:
    """Integer division that truncates toward zero, as C does it."""
    quotient = abs(value) // divisor
    return quotient if value >= 0 else -quotient


class Ramp:
    """The rate of one axis over the ticks 1, 2, ... of a command: rate(t) = r0 + a t + j t (t - 1) / 2, wrapped to int32.

    `mask` other than None belongs to firmware 2.x, whose rate rolls over by that mask instead of reversing.
    `unsigned` is for the moves at constant speed: the rate is a magnitude up to 2^31 and never wraps.
    """

    __slots__ = ("_marks", "a", "j", "mask", "r0", "unsigned")

    def __init__(self, r0: int, a: int = 0, j: int = 0, *, unsigned: bool = False, mask: int | None = None) -> None:
        self.r0 = r0
        self.a = a
        self.j = j
        self.unsigned = unsigned
        self.mask = mask
        self._marks: list[int] = [0]  # sums after each whole chunk, for the ticks that wrap

    @property
    def still(self) -> bool:
        return not (self.r0 or self.a or self.j)

    def _polynomial(self, t: int) -> int:
        return self.r0 + self.a * t + self.j * (t * (t - 1) // 2)

    def rate(self, t: int) -> int:
        """The rate register at tick t."""
        value = self._polynomial(t)
        if self.unsigned:
            return value
        return int32(value) if self.mask is None else value & self.mask

    def exact_until(self, t: int) -> bool:
        """Whether no register leaves its range in ticks 1..t, so that the closed form holds."""
        r0, a, j = self.r0, self.a, self.j
        if self.unsigned:
            return True
        low, high = (-ONE_STEP, PHASE_MASK) if self.mask is None else (0, self.mask)
        if low and abs(r0) + abs(a) * t + abs(j) * (t * t // 2) < ONE_STEP:
            return True
        turns = [1, t]
        if j:
            # The quadratic's vertex, between the two ticks where its difference a + j t changes sign.
            vertex = -a // j
            turns += [k for k in (vertex, vertex + 1) if 1 <= k <= t]
        return all(low <= self._polynomial(k) <= high for k in turns)

    def total(self, t: int) -> int:
        """Sum of the rates of ticks 1..t."""
        if t <= 0:
            return 0
        if self.exact_until(t):
            return self.r0 * t + self.a * (t * (t + 1) // 2) + self.j * ((t - 1) * t * (t + 1) // 6)
        whole, rest = divmod(t, _CHUNK)
        while len(self._marks) <= whole:
            start = (len(self._marks) - 1) * _CHUNK
            self._marks.append(self._marks[-1] + int(self.rates(start + 1, _CHUNK).sum()))
        return self._marks[whole] + (int(self.rates(whole * _CHUNK + 1, rest).sum()) if rest else 0)

    def rates(self, first: int, count: int) -> NDArray[np.int64]:
        """The rate registers of ticks first..first + count - 1, wrapped, as int64 (count,)."""
        t = np.arange(first, first + count, dtype=np.uint64)
        triangle = (t * (t - np.uint64(1))) >> np.uint64(1)
        modulus = np.uint64(0xFFFFFFFF)
        a, j, r0 = (np.uint64(v & 0xFFFFFFFF) for v in (self.a, self.j, self.r0))
        value = (r0 + a * (t & modulus) + j * (triangle & modulus)) & modulus
        if self.mask is not None:
            return (value & np.uint64(self.mask)).astype(np.int64)
        return value.astype(np.uint32).view(np.int32).astype(np.int64)

    def after(self, t: int) -> Ramp:
        """The ramp that goes on where this one is after t ticks."""
        if not (self.a or self.j):
            return self
        start = self._polynomial(t)
        if not self.unsigned:
            start = int32(start) if self.mask is None else start & self.mask
        return Ramp(start, int32(self.a + self.j * t), self.j, unsigned=self.unsigned, mask=self.mask)

    def starts_negative(self) -> bool:
        """Whether the first step to come is a backward one, by the signs the loader looks at."""
        first = int32(self.r0 + self.a)
        return first < 0 or (first == 0 and (self.a + self.j < 0 or (self.a + self.j == 0 and self.j < 0)))


# A move that has not taken its steps after this many ticks counts as one that never ends: a day where the closed form holds,
# eleven minutes where registers wrap and every tick has to be looked at.
NEVER = 1 << 31
NEVER_WRAPPING = 1 << 24


def ticks_to_take(steps: int, ramp: Ramp, acc: int) -> int | None:
    """The tick at which `steps` steps (counted in both directions) have been taken, or None if that never comes.

    `acc` is the accumulator at the start. Exact: monotone stretches by bisection, wrapping ones tick by tick.
    """
    if steps == 0:
        return 0
    if ramp.still:
        return None
    if not (ramp.a or ramp.j):
        rate = ramp.r0
        distance = steps * ONE_STEP - acc if rate > 0 else acc + 1 + (steps - 1) * ONE_STEP
        return -(-distance // abs(rate))
    taken, start, phase = 0, 0, acc
    while start < NEVER:
        stop = _monotone_stretch(ramp, start)
        if stop is None:
            return _ticks_by_chunks(steps - taken, ramp, phase, start)
        base = ramp.total(start)
        here = phase >> 31
        reached = abs(((phase + ramp.total(stop) - base) >> 31) - here)
        if taken + reached >= steps:
            low, high = start, stop
            while high - low > 1:
                middle = (low + high) // 2
                if taken + abs(((phase + ramp.total(middle) - base) >> 31) - here) >= steps:
                    high = middle
                else:
                    low = middle
            return high
        taken += reached
        phase += ramp.total(stop) - base
        start = stop
    return None


def _monotone_stretch(ramp: Ramp, start: int) -> int | None:
    """The last tick of the stretch after `start` in which the rate keeps its sign and no register wraps; None if it wraps."""
    stop = start + 1
    positive = ramp.rate(stop) >= 0
    if not ramp.exact_until(stop):
        return None
    reach = 1
    while stop < NEVER:
        further = stop + reach
        if ramp.exact_until(further) and _keeps_sign(ramp, stop, further, positive):
            stop = further
            reach *= 2
        elif reach > 1:
            reach = max(1, reach // 4)
        else:
            break
    return stop


def _keeps_sign(ramp: Ramp, first: int, last: int, positive: bool) -> bool:
    ticks = [first, last]
    if ramp.j:
        vertex = -ramp.a // ramp.j
        ticks += [k for k in (vertex, vertex + 1) if first <= k <= last]
    return all((ramp.rate(k) >= 0) == positive for k in ticks)


def _ticks_by_chunks(steps: int, ramp: Ramp, phase: int, start: int) -> int | None:
    last = start + NEVER_WRAPPING
    while start < last:
        sums = np.cumsum(ramp.rates(start + 1, _CHUNK)) + (phase & PHASE_MASK)
        whole = np.concatenate(([0], sums >> 31))
        taken = np.cumsum(np.abs(np.diff(whole)))
        if taken[-1] >= steps:
            return start + 1 + int(np.searchsorted(taken, steps))
        steps -= int(taken[-1])
        phase = int(sums[-1])
        start += _CHUNK
    return None
