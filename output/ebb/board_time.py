"""How long a command keeps the board busy, to within a tick or two: what the streamer paces itself by.

The exact arithmetic, to the tick, is elsewhere; here an estimate is enough, because the board itself is asked how far it is.
Steps are floor(F / 2^31) of F = R t + A t^2 / 2 (+ J t^3 / 6), one addition per 40 us tick.
"""

from __future__ import annotations

from math import sqrt

from output.ebb.arithmetic import TICK_S, NeverEnds, State, StepRateRefused, execute
from output.ebb.commands import HM, L3, LM, LT, S2, SM, SP, T3, TD, TP, TR, XM, Command

_FULL = 2.0**31
_NEVER_S = 100.0  # a low-level move that never ends is paced as if it took this


def board_time_s(command: Command) -> float:
    """Board seconds from the start of `command` to the start of the next one; 0 for what does not wait in the queue."""
    match command:
        case T3() | LT():
            return (command.intervals + 1) * TICK_S
        case TD():
            return 2 * (command.intervals + 1) * TICK_S
        case SM() | XM():
            return command.duration_ms / 1000
        case SP() | TP():
            return (command.duration_ms or 0) / 1000 + TICK_S if command.queued else 0.0
        case S2():
            return (command.delay_ms or 0) / 1000 if command.queued else 0.0
        case LM() | L3():
            return _low_level_s(command)
        case TR():
            return max(abs(command.steps1), abs(command.steps2 or 0)) / command.steps_per_s
        case HM():
            return 0.0  # it depends on where the pen is (`way_s`); the queue is empty before and after it
        case _:
            return TICK_S if command.queued else 0.0


def _low_level_s(command: LM | L3) -> float:
    """Both axes have taken their steps; where a jerk or a turn is in the way of the formula, by the firmware's arithmetic."""
    axes = ((command.rate1, command.steps1, command.accel1), (command.rate2, command.steps2, command.accel2))
    ends_s = [_axis_s(*axis) for axis in axes]
    if not isinstance(command, L3) and None not in ends_s:
        return max(end_s or 0.0 for end_s in ends_s)
    try:
        return execute(command, State()).ticks * TICK_S
    except (NeverEnds, StepRateRefused):
        return _NEVER_S


def _axis_s(rate: int, steps: int, accel: int) -> float | None:
    """Least t > 0 with |R t + A t^2 / 2| = |steps| 2^31; None for an axis that turns before it gets there."""
    distance = abs(steps) * _FULL
    if not steps or not (rate or accel):
        return 0.0
    rate, accel = abs(rate), accel if rate >= 0 else -accel
    discriminant = rate * rate + 2.0 * accel * distance
    if discriminant < 0 or rate + sqrt(discriminant) <= 0:
        return None
    return 2.0 * distance / (rate + sqrt(discriminant)) * TICK_S


def way_s(command: HM, steps: tuple[int, int]) -> float:
    """At most so long an HM takes from where the counters are `steps`: old firmware goes there in two lines."""
    away = abs(steps[0] - (command.position1 or 0)) + abs(steps[1] - (command.position2 or 0))
    return away / command.steps_per_s
