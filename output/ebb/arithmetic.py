"""What firmware 3 does with a motion command, exactly: integer registers, 40 us ticks, truncations, rounding of its floats.

One step is ONE_STEP = 2^31 units of an accumulator. Every tick, for each axis: Accel += Jerk, Rate += Accel, acc += Rate; when
that carries out of 31 bits the motor steps, in the direction of Rate's sign. So with F = acc + sum of rates over the ticks

    position += floor(F / 2^31),  acc = F mod 2^31

and position * 2^31 + acc is one number that only ever grows by the sum of the rates: no command loses a fraction of a step.
The parser's truncations are part of the law: r0 = R - trunc(A/2) + trunc(J/6), and in tick t (from 1)

    rate(t) = r0 + A t + J t(t-1)/2,    sum to T = r0 T + A T(T+1)/2 + J (T-1)T(T+1)/6

Registers are 32 bits wide and wrap. Source: the firmware's observed behaviour, 3.0.0 to 3.0.3; it is the same in all four.
`arithmetic_old` has the same for 2.x and 1.x. Nothing here knows plans, queues or time outside ticks.
"""

from __future__ import annotations

from itertools import pairwise
from math import isqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from output.ebb.commands import HM, L3, LM, LT, SM, T3, TD, TR, XM, Command
from output.wording import counted

ONE_STEP = 1 << 31
TICKS_PER_MS = 25
TICK_S = 40e-6
DELAY_CAP_MS = 100_000
# A step-limited move longer than this many ticks (an hour and a half) is treated as one that does not end.
_SEARCH_TICKS = 1 << 27
_CHUNK = 1 << 16

Ints = NDArray[np.int64]


class Profile(NamedTuple):
    """One axis during some ticks: rate(t) = r0 + accel t + jerk t(t-1)/2 in tick t = 1, 2, ..., in 2^-31 steps per tick."""

    r0: int
    accel: int
    jerk: int

    def rate(self, tick: int) -> int:
        return self.r0 + self.accel * tick + self.jerk * (tick * (tick - 1) // 2)

    def total(self, ticks: int) -> int:
        """Sum of the rates of ticks 1 to `ticks`."""
        return self.r0 * ticks + self.accel * (ticks * (ticks + 1) // 2) + self.jerk * ((ticks - 1) * ticks * (ticks + 1) // 6)

    def later(self, ticks: int) -> Profile:
        """The same motion seen from `ticks` ticks on."""
        return Profile(
            self.r0 + self.accel * ticks + self.jerk * (ticks * (ticks - 1) // 2), self.accel + self.jerk * ticks, self.jerk
        )


STILL = Profile(0, 0, 0)


class Segment(NamedTuple):
    """Both axes during `ticks` ticks. `phase` is each motor's position at its start in 2^-31 steps, with the fraction of a step
    that the accumulator holds, centred: phase / 2^31 is within half a step of the step counter, and continuous."""

    ticks: int
    phase: tuple[int, int]
    profile: tuple[Profile, Profile]


class State(NamedTuple):
    """Step counters (QS) and accumulators (QU,200)."""

    position: tuple[int, int] = (0, 0)
    acc: tuple[int, int] = (0, 0)


class Executed(NamedTuple):
    """What a command did. `ticks` execute; `dead_ticks` pass before the next command starts. `overflow` is True when a register
    left its 32 bits, which no motion means to do."""

    state: State
    ticks: int
    dead_ticks: int
    segments: tuple[Segment, ...]
    overflow: bool = False


class NeverEnds(ValueError):
    """A step-limited move on an axis that never takes its steps: the queue would wait for it for ever."""


class StepRateRefused(ValueError):
    """The step rate that the board computes for SM, XM, TR or HM is one that it answers with an error."""


def trunc_div(value: int, divisor: int) -> int:
    """C's integer division, towards zero."""
    return -(-value // divisor) if value < 0 else value // divisor


def _int32(value: int) -> int:
    return (value + ONE_STEP) % (2 * ONE_STEP) - ONE_STEP


def negated(value: int) -> int:
    """What a 32-bit register holds of -value."""
    return _int32(-value)


def profile_of(rate: int, accel: int, jerk: int) -> Profile:
    """The profile that the parser makes of a command's Rate, Accel and Jerk."""
    return Profile(rate - trunc_div(accel, 2) + trunc_div(jerk, 6), accel, jerk)


def starts_negative(profile: Profile) -> bool:
    """Whether the axis starts backwards, by which Clear presets the accumulator to 2^31 - 1 instead of 0.

    The firmware adds in 32 bits here too: what is beyond them starts the other way.
    """
    first, second = _int32(profile.r0 + profile.accel), _int32(profile.accel + profile.jerk)
    return first < 0 or (first == 0 and (second < 0 or (second == 0 and profile.jerk < 0)))


def execute(command: Command, state: State) -> Executed:
    """Run one queued command from `state`. Commands that do not step the motors are for the caller.

    Raises NeverEnds, StepRateRefused; TypeError for a command that is not one of the motion commands.
    """
    match command:
        case T3():
            one, two = (
                profile_of(command.rate1, command.accel1, command.jerk1),
                profile_of(command.rate2, command.accel2, command.jerk2),
            )
            return _timed(command.intervals, (one, two), command.clear, state)
        case LT():
            return _timed(
                command.intervals,
                (profile_of(command.rate1, command.accel1, 0), profile_of(command.rate2, command.accel2, 0)),
                command.clear,
                state,
            )
        case TD():
            return _double(command, state)
        case LM():
            one_steps = (command.rate1, command.steps1, command.accel1, 0)
            two_steps = (command.rate2, command.steps2, command.accel2, 0)
            return _stepped(one_steps, two_steps, command.clear, state)
        case L3():
            one_steps = (command.rate1, command.steps1, command.accel1, command.jerk1)
            two_steps = (command.rate2, command.steps2, command.accel2, command.jerk2)
            return _stepped(one_steps, two_steps, command.clear, state)
        case SM():
            steps = (command.steps1, command.steps2 or 0)
            return _constant(steps, sm_rates(command.duration_ms, steps), command.clear, state, command.duration_ms)
        case XM():
            steps = (_int32(command.steps_a + command.steps_b), _int32(command.steps_a - command.steps_b))
            return _constant(steps, sm_rates(command.duration_ms, steps), command.clear, state, command.duration_ms)
        case TR():
            steps = (command.steps1, command.steps2 or 0)
            return _constant(steps, tr_rates(command.steps_per_s, steps), command.clear, state, 0)
        case HM():
            to = (command.position1 or 0, command.position2 or 0)
            steps = (to[0] - state.position[0], to[1] - state.position[1])
            return _constant(steps, tr_rates(command.steps_per_s, steps), None, state, 0)
        case _:
            raise TypeError(f"{command.name} does not step the motors")


def ticks_of_wait(duration_ms: int | None) -> int:
    """Ticks that SP, TP and S2 keep the queue waiting: at least one."""
    return max(1, TICKS_PER_MS * (duration_ms or 0))


def _centred(position: int, acc: int) -> int:
    return position * ONE_STEP + acc - ONE_STEP // 2


def _cleared(clear: int | None, profiles: tuple[Profile, Profile], acc: tuple[int, int]) -> tuple[int, int]:
    bits = min(clear or 0, 3)
    preset = [ONE_STEP - 1 if starts_negative(profile) else 0 for profile in profiles]
    return (preset[0] if bits & 1 else acc[0], preset[1] if bits & 2 else acc[1])


def _timed(ticks: int, profiles: tuple[Profile, Profile], clear: int | None, state: State) -> Executed:
    acc = _cleared(clear, profiles, state.acc)
    position, after, overflow = [0, 0], [0, 0], False
    for axis, profile in enumerate(profiles):
        if registers_hold(profile, ticks):
            total = acc[axis] + profile.total(ticks)
        else:
            overflow = True
            total = acc[axis] + wrapped_total(profile, ticks)
        steps, after[axis] = divmod(total, ONE_STEP)
        position[axis] = state.position[axis] + steps
    start = (_centred(state.position[0], acc[0]), _centred(state.position[1], acc[1]))
    end = State((position[0], position[1]), (after[0], after[1]))
    return Executed(end, ticks, 1, (Segment(ticks, start, profiles),), overflow)


def _double(command: TD, state: State) -> Executed:
    # The second half never clears, whatever the reference says. Its jerk is negated in 32 bits, where -2^31 has no opposite.
    first = (profile_of(command.rate1a, 0, command.jerk1), profile_of(command.rate2a, 0, command.jerk2))
    second = (
        profile_of(command.rate1b, command.accel1, negated(command.jerk1)),
        profile_of(command.rate2b, command.accel2, negated(command.jerk2)),
    )
    a = _timed(command.intervals, first, command.clear, state)
    b = _timed(command.intervals, second, None, a.state)
    return Executed(b.state, a.ticks + b.ticks, 2, a.segments + b.segments, a.overflow or b.overflow)


def _stepped(one: tuple[int, int, int, int], two: tuple[int, int, int, int], clear: int | None, state: State) -> Executed:
    """LM and L3: each axis runs until it has taken its steps, in whichever direction."""
    profiles, wanted = [STILL, STILL], [0, 0]
    for axis, (rate, steps, accel, jerk) in enumerate((one, two)):
        if steps < 0:  # Jerk keeps its sign: the firmware forgets it.
            rate, steps, accel = negated(rate), -steps, negated(accel)
        profiles[axis], wanted[axis] = profile_of(rate, accel, jerk), steps
    pair = (profiles[0], profiles[1])
    acc = _cleared(clear, pair, state.acc)
    # An axis without steps is not touched while it runs, but Clear has presets for it all the same.
    runs = [_run(profile, acc[axis], steps) for axis, (profile, steps) in enumerate(zip(profiles, wanted, strict=True))]
    start = (_centred(state.position[0], acc[0]), _centred(state.position[1], acc[1]))
    end = State((state.position[0] + runs[0].moved, state.position[1] + runs[1].moved), (runs[0].acc, runs[1].acc))
    ticks = max(1, runs[0].ticks, runs[1].ticks)
    segments = _joined(start, pair, (runs[0].ticks, runs[1].ticks), ticks)
    return Executed(end, ticks, 0, segments, runs[0].overflow or runs[1].overflow)


def _joined(
    start: tuple[int, int], profiles: tuple[Profile, Profile], ends: tuple[int, int], ticks: int
) -> tuple[Segment, ...]:
    """Segments of a move whose axes stop at different ticks."""
    borders = sorted({0, *ends, ticks})
    segments = []
    for begin, end in pairwise(borders):
        phases, parts = [0, 0], [STILL, STILL]
        for axis, profile in enumerate(profiles):
            run = min(begin, ends[axis])
            phases[axis] = start[axis] + (profile.total(run) if run else 0)
            if ends[axis] > begin:
                parts[axis] = profile.later(begin)
        segments.append(Segment(end - begin, (phases[0], phases[1]), (parts[0], parts[1])))
    return tuple(segments)


class _Run(NamedTuple):
    ticks: int
    moved: int
    acc: int
    overflow: bool = False


def _run(profile: Profile, acc: int, steps: int) -> _Run:
    """The first tick at which `steps` steps have been taken, both directions counted. Raises NeverEnds."""
    if steps == 0:
        return _Run(0, 0, acc)
    if profile == STILL:
        raise NeverEnds(f"{counted(steps, 'step')} with rate, acceleration and jerk 0")
    done, taken = 0, 0
    for end in _one_way_spans(profile):
        before = (acc + profile.total(done)) // ONE_STEP
        count = abs((acc + profile.total(end)) // ONE_STEP - before)
        if taken + count >= steps:
            tick = _first_tick(profile, acc, before, steps - taken, done, end)
            moved, rest = divmod(acc + profile.total(tick), ONE_STEP)
            return _Run(tick, moved, rest)
        done, taken = end, taken + count
    return _run_wrapped(profile, acc, steps)


def _one_way_spans(profile: Profile) -> list[int]:
    """Ticks at which the sign of the rate may change, ascending; the last is where a register leaves 32 bits, or far."""
    far = 1 << 62
    ends = sorted({t for t in _crossings(profile, 0) if 0 < t < far})
    limits = [t for bound in (ONE_STEP, -ONE_STEP - 1) for t in _crossings(profile, bound) if t > 0]
    limits = [t for t in limits if not -ONE_STEP <= profile.rate(t + 1) < ONE_STEP]
    stop = min([t for t in limits if t >= 0], default=far)
    if not -ONE_STEP <= profile.rate(1) < ONE_STEP:
        stop = 0
    return [t for t in ends if t < stop] + [stop]


def _crossings(profile: Profile, level: int) -> set[int]:
    """Ticks t (and their neighbours) between which rate(t) passes `level`."""
    # 2 rate(t) = J t^2 + (2 A - J) t + 2 r0
    a, b, c = profile.jerk, 2 * profile.accel - profile.jerk, 2 * (profile.r0 - level)
    if a == 0:
        roots = [] if b == 0 else [-c // b]
    else:
        under = b * b - 4 * a * c
        if under < 0:
            return set()
        root = isqrt(under)
        roots = [(-b - root) // (2 * a), (-b + root) // (2 * a)]
    return {r + d for r in roots for d in (-1, 0, 1) if r + d >= 0}


def _first_tick(profile: Profile, acc: int, before: int, steps: int, low: int, high: int) -> int:
    """Bisect for the first tick in (low, high] by which `steps` more steps than `before` were taken; rates of one sign."""
    while high - low > 1:
        middle = (low + high) // 2
        if abs((acc + profile.total(middle)) // ONE_STEP - before) >= steps:
            high = middle
        else:
            low = middle
    return high


def _wrapped_rates(profile: Profile, first: int, count: int) -> Ints:
    """The rate register in ticks first .. first + count - 1, wrapped to 32 bits."""
    t = np.arange(first, first + count, dtype=np.uint64)
    pairs = t * (t - np.uint64(1)) // np.uint64(2)
    mask = (1 << 64) - 1
    with np.errstate(over="ignore"):
        rate = np.uint64(profile.r0 & mask) + np.uint64(profile.accel & mask) * t + np.uint64(profile.jerk & mask) * pairs
    return rate.astype(np.uint32).astype(np.int32).astype(np.int64)


def wrapped_total(profile: Profile, ticks: int) -> int:
    total = 0
    for first in range(1, ticks + 1, _CHUNK):
        total += int(_wrapped_rates(profile, first, min(_CHUNK, ticks + 1 - first)).sum())
    return total


def _run_wrapped(profile: Profile, acc: int, steps: int) -> _Run:
    """Tick by tick, for rates that wrap. Raises NeverEnds when that takes more than an hour and a half of board time."""
    total, taken = acc, 0
    for first in range(1, _SEARCH_TICKS, _CHUNK):
        sums = total + np.cumsum(_wrapped_rates(profile, first, _CHUNK))
        position = np.concatenate(([total >> 31], sums >> 31))
        counts = taken + np.cumsum(np.abs(np.diff(position)))
        if counts[-1] >= steps:
            at = int(np.searchsorted(counts, steps))
            moved, rest = divmod(int(sums[at]), ONE_STEP)
            return _Run(first + at, moved, rest, True)
        total, taken = int(sums[-1]), int(counts[-1])
    raise NeverEnds(f"{counted(steps, 'step is', 'steps are')} not taken within {_SEARCH_TICKS * TICK_S / 60:.0f} minutes")


def registers_hold(profile: Profile, ticks: int) -> bool:
    """True when the rate stays within its 32 bits in every tick from 1 to `ticks`."""
    ends = [profile.rate(1), profile.rate(ticks)]
    if profile.jerk:
        turn = trunc_div(profile.jerk - 2 * profile.accel, 2 * profile.jerk)
        ends += [profile.rate(t) for t in (turn - 1, turn, turn + 1) if 1 <= t <= ticks]
    return min(ends) >= -ONE_STEP and max(ends) < ONE_STEP


def _constant(steps: tuple[int, int], rates: tuple[int, int], clear: int | None, state: State, delay_ms: int) -> Executed:
    """SM, XM, TR and HM: constant rates, magnitudes in the accumulators, direction from the sign of the steps."""
    if steps == (0, 0):
        return _delay(state, delay_ms)
    bits = clear or 0
    acc = (0 if bits & 1 else state.acc[0], 0 if bits & 2 else state.acc[1])
    ticks, after = [0, 0], [acc[0], acc[1]]
    for axis in (0, 1):
        if steps[axis]:
            needed = abs(steps[axis]) * ONE_STEP - acc[axis]
            ticks[axis] = -(-needed // rates[axis])
            after[axis] = rates[axis] * ticks[axis] - needed
    signs = (-1 if steps[0] < 0 else 1, -1 if steps[1] < 0 else 1)
    start = (_magnitude(state.position[0], acc[0], signs[0]), _magnitude(state.position[1], acc[1], signs[1]))
    profiles = (Profile(signs[0] * rates[0], 0, 0), Profile(signs[1] * rates[1], 0, 0))
    total = max(ticks)
    segments = _joined(start, profiles, (ticks[0], ticks[1]), total)
    end = State((state.position[0] + steps[0], state.position[1] + steps[1]), (after[0], after[1]))
    return Executed(end, total, 0, segments)


def _magnitude(position: int, acc: int, sign: int) -> int:
    return position * ONE_STEP + sign * (acc - ONE_STEP // 2)


def _delay(state: State, delay_ms: int) -> Executed:
    # Clear is not looked at for a delay.
    ticks = max(1, TICKS_PER_MS * min(delay_ms, DELAY_CAP_MS))
    here = (_centred(state.position[0], state.acc[0]), _centred(state.position[1], state.acc[1]))
    return Executed(state, ticks, 0, (Segment(ticks, here, (STILL, STILL)),))


# The firmware's single-precision floats: C18's, which are IEEE but for two shortcuts.


class _Float(NamedTuple):
    """mantissa * 2^exponent, mantissa of exactly 24 bits, or 0."""

    mantissa: int
    exponent: int


def _rounded(value: int, extra_bits: int, exponent: int, sticky: bool = False) -> _Float:
    """Drop `extra_bits` low bits, to nearest, ties to even."""
    keep, low = value >> extra_bits, value & ((1 << extra_bits) - 1)
    half = 1 << (extra_bits - 1) if extra_bits else 1
    if low > half or (low == half and (sticky or keep & 1)):
        keep += 1
    if keep >> 24:
        return _Float(keep >> 1, exponent + extra_bits + 1)
    return _Float(keep, exponent + extra_bits)


def _from_int(value: int) -> _Float:
    bits = value.bit_length()
    if bits <= 24:
        return _Float(value << (24 - bits), bits - 24)
    return _rounded(value, bits - 24, 0)


def _divide(a: _Float, b: _Float) -> _Float:
    shift = 24 if a.mantissa >= b.mantissa else 25
    quotient, remainder = divmod(a.mantissa << shift, b.mantissa)
    # The library loses the sticky bit when what remains is exactly 0x800000.
    return _rounded(quotient, 1, a.exponent - b.exponent - shift, sticky=remainder not in (0, 0x800000))


def _multiply(a: _Float, b: _Float) -> _Float:
    """The library drops the low partial products of the 24 by 24 bit multiplication."""
    if not a.mantissa or not b.mantissa:
        return _Float(0, 0)
    a0, a1, a2 = a.mantissa >> 16, a.mantissa >> 8 & 255, a.mantissa & 255
    b0, b1, b2 = b.mantissa >> 16, b.mantissa >> 8 & 255, b.mantissa & 255
    product = (a0 * b0 << 16) + (a0 * b1 + a1 * b0 << 8) + a0 * b2 + a1 * b1 + a2 * b0 + (a1 * b2 >> 8) + (a2 * b1 >> 8)
    exponent = a.exponent + b.exponent + 16
    if product < 1 << 31:
        product, exponent = product << 1, exponent - 1
    return _rounded(product, 8, exponent)


def _truncated(value: _Float) -> int:
    return value.mantissa << value.exponent if value.exponent >= 0 else value.mantissa >> -value.exponent


_SM_CONSTANT = _Float(85899344 >> 3, 3)  # 85899345.92f
_TR_CONSTANT = _Float(10995116, -7)  # 85899.34592f


def sm_rates(duration_ms: int, steps: tuple[int, int]) -> tuple[int, int]:
    """The rates that SM and XM compute for each axis. Raises StepRateRefused for 25 to 50 kHz and for less than 1.2e-5 Hz."""
    per_ms = _divide(_SM_CONSTANT, _from_int(duration_ms))
    return (_sm_rate(per_ms, steps[0], 1), _sm_rate(per_ms, steps[1], 2))


def _sm_rate(per_ms: _Float, steps: int, axis: int) -> int:
    if steps == 0:
        return 0
    rate = _truncated(_multiply(_from_int(abs(steps)), per_ms))
    if rate >= 1 << 32:
        return ONE_STEP - 1
    if rate > ONE_STEP:
        raise StepRateRefused(f"axis {axis} step rate too high: {counted(abs(steps), 'step')}")
    if rate == 0:
        raise StepRateRefused(f"axis {axis} step rate too slow: {counted(abs(steps), 'step')}")
    return rate


def tr_rates(steps_per_s: int, steps: tuple[int, int]) -> tuple[int, int]:
    """The rates of TR and HM: the longer axis at `steps_per_s`, the other in proportion, from 1 to 2^31 - 1."""
    sizes = (abs(steps[0]), abs(steps[1]))
    major = 0 if sizes[0] >= sizes[1] else 1
    if sizes[major] == 0:
        return (0, 0)
    hz = _from_int(steps_per_s)
    rates = [0, 0]
    rates[major] = _truncated(_multiply(hz, _TR_CONSTANT))
    minor = 1 - major
    if sizes[minor]:
        share = _divide(_multiply(_from_int(sizes[minor]), hz), _from_int(sizes[major]))
        rates[minor] = min(max(_truncated(_multiply(share, _TR_CONSTANT)), 1), ONE_STEP - 1)
    return (rates[0], rates[1])
