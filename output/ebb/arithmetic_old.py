"""What firmware 2.x and 1.x do with a motion command, exactly: unsigned rates, a direction fixed for each move.

Differences to `arithmetic` (firmware 3): accumulators count magnitudes whatever the direction; Rate rolls over by 2^31 instead
of reversing; LM's and LT's direction is a sign that only chooses the way; Clear always means 0; no tick is lost after LT; SM
computes its rate in integers, of which only the upper half is used for moves of up to 30 ms. Source: the behaviour page of
firmware 3, its comparison with 2.8.1, and the 2.8.1 reference.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from output.ebb.arithmetic import (
    ONE_STEP,
    STILL,
    TICKS_PER_MS,
    Executed,
    NeverEnds,
    Profile,
    Segment,
    State,
    StepRateRefused,
    trunc_div,
)
from output.ebb.commands import HM, LM, LT, SM, XM, Command
from output.wording import counted

_SEARCH_TICKS = 1 << 27
_CHUNK = 1 << 16
_DELAY_WRAP_MS = 65536
_LEAST_RATE = 112589  # 1.31 steps per second
"""A slower axis is refused."""
_MS_PER_SLOW_STEP = 763
_SHORTEST_HOMING_MS = 10


def execute(command: Command, state: State) -> Executed:
    """Run one queued motion command from `state`.

    Raises NeverEnds, StepRateRefused; TypeError for a command that is not a motion command of these versions.
    """
    match command:
        case SM():
            return _constant(command.duration_ms, (command.steps1, command.steps2 or 0), state)
        case XM():
            a, b = command.steps_a, command.steps_b
            return _constant(command.duration_ms, (a + b, a - b), state)
        case LM():
            return _stepped(command, state)
        case LT():
            return _timed(command, state)
        case HM():
            return _home(command, state)
        case _:
            raise TypeError(f"{command.name} is not a motion command of firmware 2.x")


def _phase(position: int, acc: int, sign: int) -> int:
    """Position in 2^-31 steps, centred on the step counter's cell, going the way of `sign`."""
    return position * ONE_STEP + sign * (acc - ONE_STEP // 2)


def sm_rate(duration_ms: int, steps: int) -> int:
    """SM's rate of one axis: 16 bits of n * 2^31 / ticks, the lower 16 only for moves of more than 30 ms."""
    high, rest = divmod(abs(steps) << 15, TICKS_PER_MS * duration_ms)
    rate = high << 16
    if duration_ms > 30:
        rate += (rest << 16) // (TICKS_PER_MS * duration_ms)
    return rate


def _constant(duration_ms: int, steps: tuple[int, int], state: State) -> Executed:
    if steps == (0, 0):
        ticks = max(1, TICKS_PER_MS * (duration_ms % _DELAY_WRAP_MS))
        here = (_phase(state.position[0], state.acc[0], 1), _phase(state.position[1], state.acc[1], 1))
        return Executed(state, ticks, 0, (Segment(ticks, here, (STILL, STILL)),))
    rates = [sm_rate(duration_ms, n) for n in steps]
    for axis, (rate, n) in enumerate(zip(rates, steps, strict=True), 1):
        if n and rate > ONE_STEP:
            raise StepRateRefused(f"axis {axis} step rate too high: {counted(abs(n), 'step')} in {duration_ms} ms")
        if n and rate < _LEAST_RATE:
            raise StepRateRefused(f"axis {axis} step rate below 1.31 per second: {counted(abs(n), 'step')} in {duration_ms} ms")
    return _at_rates((rates[0], rates[1]), steps, state)


def _at_rates(rates: tuple[int, int], steps: tuple[int, int], state: State) -> Executed:
    profiles = (Profile(rates[0], 0, 0), Profile(rates[1], 0, 0))
    return _counted(profiles, (abs(steps[0]), abs(steps[1])), (1 if steps[0] >= 0 else -1, 1 if steps[1] >= 0 else -1), state)


def _counted(profiles: tuple[Profile, Profile], counts: tuple[int, int], signs: tuple[int, int], state: State) -> Executed:
    """Each axis steps `counts` times the way of `signs`; a rate that goes negative rolls over to the fast end."""
    ticks, acc, overflow = [0, 0], list(state.acc), False
    for axis in (0, 1):
        if counts[axis]:
            ticks[axis], acc[axis], rolled = _count(profiles[axis], state.acc[axis], counts[axis])
            overflow |= rolled
    position = (state.position[0] + signs[0] * counts[0], state.position[1] + signs[1] * counts[1])
    total = max(1, *ticks)
    segments = _segments(profiles, signs, (ticks[0], ticks[1]), total, state)
    return Executed(State(position, (acc[0], acc[1])), total, 0, segments, overflow)


def _segments(
    profiles: tuple[Profile, Profile], signs: tuple[int, int], ends: tuple[int, int], ticks: int, state: State
) -> tuple[Segment, ...]:
    borders = sorted({0, *ends, ticks})
    segments = []
    for begin, end in pairwise(borders):
        phases, parts = [0, 0], [STILL, STILL]
        for axis, profile in enumerate(profiles):
            run = min(begin, ends[axis])
            moved = profile.total(run) if run else 0
            phases[axis] = _phase(state.position[axis], state.acc[axis] + moved, signs[axis])
            if ends[axis] > begin:
                later = profile.later(begin)
                parts[axis] = Profile(signs[axis] * later.r0, signs[axis] * later.accel, 0)
        segments.append(Segment(end - begin, (phases[0], phases[1]), (parts[0], parts[1])))
    return tuple(segments)


def _count(profile: Profile, acc: int, steps: int) -> tuple[int, int, bool]:
    """Ticks until `steps` steps, the accumulator then, and whether the rate rolled over. Raises NeverEnds."""
    if profile.accel == 0:
        if profile.r0 == 0:
            raise NeverEnds(f"{counted(steps, 'step')} with rate and acceleration 0")
        needed = steps * ONE_STEP - acc
        ticks = -(-needed // profile.r0)
        return ticks, profile.r0 * ticks - needed, False
    # Ticks for which the rate keeps to 31 bits: the last t with 0 <= r0 + A t < 2^31.
    room = profile.r0 if profile.accel < 0 else ONE_STEP - 1 - profile.r0
    smooth = room // abs(profile.accel)
    if 0 <= profile.rate(1) < ONE_STEP and acc + profile.total(smooth) >= steps * ONE_STEP:
        low, high = 0, smooth
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if acc + profile.total(middle) >= steps * ONE_STEP else (middle, high)
        return high, acc + profile.total(high) - steps * ONE_STEP, False
    return _count_rolling(profile, acc, steps)


def _count_rolling(profile: Profile, acc: int, steps: int) -> tuple[int, int, bool]:
    total = acc
    for first in range(1, _SEARCH_TICKS, _CHUNK):
        t = np.arange(first, first + _CHUNK, dtype=np.int64)
        sums = total + np.cumsum((profile.r0 + profile.accel * t) & (ONE_STEP - 1))
        if sums[-1] >> 31 >= steps:
            at = int(np.searchsorted(sums, steps * ONE_STEP))
            return first + at, int(sums[at]) - steps * ONE_STEP, True
        total = int(sums[-1])
    raise NeverEnds(f"{counted(steps, 'step is', 'steps are')} not taken within an hour and a half")


def _stepped(command: LM, state: State) -> Executed:
    bits = min(command.clear or 0, 3)
    state = State(state.position, (0 if bits & 1 else state.acc[0], 0 if bits & 2 else state.acc[1]))
    profiles = tuple(
        Profile(rate - trunc_div(accel, 2), accel, 0)
        for rate, accel in ((command.rate1, command.accel1), (command.rate2, command.accel2))
    )
    steps = (command.steps1, command.steps2)
    signs = (-1 if steps[0] < 0 else 1, -1 if steps[1] < 0 else 1)
    return _counted((profiles[0], profiles[1]), (abs(steps[0]), abs(steps[1])), signs, state)


def _timed(command: LT, state: State) -> Executed:
    bits = min(command.clear or 0, 3)
    acc = [0 if bits & 1 else state.acc[0], 0 if bits & 2 else state.acc[1]]
    position, phases, parts, overflow = list(state.position), [0, 0], [STILL, STILL], False
    for axis, (rate, accel) in enumerate(((command.rate1, command.accel1), (command.rate2, command.accel2))):
        sign = -1 if rate < 0 else 1
        profile = Profile(abs(rate) - trunc_div(accel, 2), accel, 0)
        rolls = min(profile.rate(1), profile.rate(command.intervals)) < 0
        rolls |= max(profile.rate(1), profile.rate(command.intervals)) >= ONE_STEP
        phases[axis] = _phase(position[axis], acc[axis], sign)
        parts[axis] = Profile(sign * profile.r0, sign * profile.accel, 0)
        total = acc[axis] + (_rolling_total(profile, command.intervals) if rolls else profile.total(command.intervals))
        steps, acc[axis] = divmod(total, ONE_STEP)
        position[axis] += sign * steps
        overflow |= rolls
    segment = Segment(command.intervals, (phases[0], phases[1]), (parts[0], parts[1]))
    return Executed(State((position[0], position[1]), (acc[0], acc[1])), command.intervals, 0, (segment,), overflow)


def _rolling_total(profile: Profile, ticks: int) -> int:
    total = 0
    for first in range(1, ticks + 1, _CHUNK):
        t = np.arange(first, min(first + _CHUNK, ticks + 1), dtype=np.int64)
        total += int(((profile.r0 + profile.accel * t) & (ONE_STEP - 1)).sum())
    return total


def _home(command: HM, state: State) -> Executed:
    """A line to the position, the longer axis at the asked rate, as SM computes it; accumulators are cleared first.

    Where the shorter axis would be slower than 1.31 steps per second, both go as far as it has to, and then the other alone.
    """
    to = (command.position1 or 0, command.position2 or 0)
    steps = (to[0] - state.position[0], to[1] - state.position[1])
    segments: tuple[Segment, ...] = ()
    state, ticks = State(state.position, (0, 0)), 0
    for part in _homing_parts(steps, command.steps_per_s):
        duration_ms = _homing_ms(part, command.steps_per_s)
        rate1, rate2 = (min(sm_rate(duration_ms, n), ONE_STEP) for n in part)
        done = _at_rates((rate1, rate2), part, state)
        state, ticks, segments = done.state, ticks + done.ticks, segments + done.segments
    return Executed(state, max(ticks, 1), 0, segments)


def _homing_ms(steps: tuple[int, int], steps_per_s: int) -> int:
    return max(_SHORTEST_HOMING_MS, max(abs(steps[0]), abs(steps[1])) * 1000 // steps_per_s)


def _homing_parts(steps: tuple[int, int], steps_per_s: int) -> list[tuple[int, int]]:
    shorter, longer = sorted((abs(steps[0]), abs(steps[1])))
    if not longer:
        return []
    if not shorter or shorter * _MS_PER_SLOW_STEP >= _homing_ms(steps, steps_per_s):
        return [steps]
    corner = (shorter if steps[0] > 0 else -shorter, shorter if steps[1] > 0 else -shorter)
    return [corner, (steps[0] - corner[0], steps[1] - corner[1])]
