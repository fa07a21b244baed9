"""A plan's program that can be held in the middle of a stroke: the pen slows down along its path, stops, and lifts.

The board is far behind the program: what has been sent will be executed, so a hold begins with the first command that has not
been sent. What the board's counters and accumulators will be there is known exactly, by the firmware's arithmetic; how far the
plan's motion is there follows from the time that has passed in it, or, where commands take longer than the plan's pieces, from
the place. From there on the motion is replaced by one that comes to rest on the same path (planning.motion.hold).

    actions --encode--> items   0 1 2 [3 4 5 6 7 8] 9 ...          one action's items, in brackets
                              taken = 6:   ^ state, plan time      -> [brake] lift

Clocks: plan time of an action's motion, and board ticks since the action began. The program is made in the streamer's planning
thread and held from its loop; the log between them has a lock.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from output.ebb import arithmetic, arithmetic_old
from output.ebb.arithmetic import ONE_STEP, State
from output.ebb.commands import Command, MotionCommand
from output.ebb.encode import BoardSetup, Encoder, epilogue
from output.ebb.producer import BUFFER_ITEMS
from output.ebb.program import Mark, Program
from output.ebb.resume import Place
from planning.motion.hold import stop_on_path
from planning.motion.limits import Limits
from planning.motion.plan import TICK_S, Action, Draw, Lift, Lower, Motion, joined_motion

Array = NDArray[np.float64]

# The program is made at most so many items ahead of what is sent; what lies further back can no longer be asked for.
_AHEAD = BUFFER_ITEMS + 64
# A place this near (steps) to where the plan's own time says is there; else commands take longer than the plan's pieces.
_ON_TIME_STEPS = 1.5
# A motion that runs at less than this of plan speed is held from the speed that it really has.
_FULL_PACE = 0.98
_PACE_OVER_S = 0.05
# How finely a slowed motion is followed, and how much further than its command's time it may be found.
_LOOK_EVERY_S = 0.0002
_CATCH_UP_S = 0.01


@dataclass(slots=True)
class _Drawn:
    """A draw, or a part of one, whose items have been made, or are being made.

    `first` is the number of its first item; `states[i]` and `ticks[i]` are the board's state and the time since the draw began
    after i of them. `before_mm` of its stroke was drawn before it.
    """

    first: int
    motion: Motion
    stroke: int
    last: bool
    before_mm: float
    states: list[State]
    ticks: list[int] = field(default_factory=lambda: [0])


class PausableProgram:
    """`before`, the commands of `actions`, and the epilogue; an iterable for one run. `hold` stops it on the path.

    After a hold, `place` is where the pen comes to rest: on which stroke, where the motors stand, and how much is drawn.
    """

    def __init__(self, before: Program, actions: Iterable[Action], setup: BoardSetup, limits: Limits, lift_s: float) -> None:
        self.place: Place | None = None
        self._before = before
        self._actions = actions
        self._setup = setup
        self._limits = limits
        self._lift_s = lift_s
        self._execute = arithmetic_old.execute if setup.firmware.old_arithmetic else arithmetic.execute
        self._lock = threading.Lock()
        self._drawn: deque[_Drawn] = deque()
        self._made = 0

    def __iter__(self) -> Iterator[Command | Mark]:
        for item in self._before:
            self._made += 1
            yield item
        encoder = Encoder(self._setup)
        stroke, before_mm = -1, 0.0
        for action in self._actions:
            if isinstance(action, Lower):
                stroke, before_mm = action.stroke, 0.0
            if isinstance(action, Draw) and action.stroke == stroke:
                yield from self._drawing(action, encoder, before_mm)
                before_mm += _length_mm(action.motion, action.motion.total_s)
                continue
            for item in encoder.action(action):
                self._made += 1
                yield item
        yield from epilogue(self._setup)

    def _drawing(self, action: Draw, encoder: Encoder, before_mm: float) -> Iterator[Command | Mark]:
        """The items of a draw, with what the board will be at after each."""
        state = encoder.state
        drawn = _Drawn(self._made, action.motion, action.stroke, action.last, before_mm, [state])
        with self._lock:
            self._drawn.append(drawn)
            while len(self._drawn) > 2 and self._drawn[1].first + _AHEAD < self._made:
                self._drawn.popleft()
        for item in encoder.action(action):
            if isinstance(item, MotionCommand):
                done = self._execute(item, state)
                state = done.state
            with self._lock:
                drawn.states.append(state)
                drawn.ticks.append(drawn.ticks[-1] + (done.ticks if isinstance(item, MotionCommand) else 0))
            self._made += 1
            yield item

    def hold(self, taken: int) -> Program | None:
        """What to send in place of everything from item number `taken` on: braking on the path, and pen up.

        None while no line is being drawn there, or its end is too near to stop before it. Raises what encoding raises.
        """
        with self._lock:
            now = [drawn for drawn in self._drawn if drawn.first < taken <= drawn.first + len(drawn.ticks) - 1]
            if not now:
                return None
            drawn, count = now[-1], taken - now[-1].first
            states, ticks = drawn.states[: count + 1], drawn.ticks[: count + 1]
            parts = [part for part in self._drawn if part.stroke == drawn.stroke and part.first >= drawn.first]
        motion = joined_motion([part.motion for part in parts])
        at_s, pace = self._plan_time(motion, states, ticks)
        paced = motion if pace >= _FULL_PACE else _paced(motion, pace)
        try:
            stopping, end_s = stop_on_path(paced, min(at_s / pace, paced.total_s), self._limits)
        except ValueError:
            if parts[-1].last:
                raise
            return None  # it would come to rest on a part of the stroke that has not been planned yet
        end_s *= motion.total_s / paced.total_s
        if not len(stopping) or end_s >= motion.total_s - TICK_S:
            return None
        encoder = Encoder(self._setup, states[-1])
        encoder.reached = self._steps(stopping, np.zeros(1))[0] * ONE_STEP
        items: list[Command | Mark] = list(encoder.motion(stopping))
        drawn_mm = drawn.before_mm + _length_mm(motion, end_s)
        scale = float(np.sqrt(abs(np.linalg.det(self._setup.kinematics.steps_per_mm))))
        self.place = Place(0, drawn.stroke, False, encoder.state.position, drawn_mm * scale, drawn.stroke)
        items += encoder.action(Lift(self._lift_s))
        return items

    def _plan_time(self, motion: Motion, states: list[State], ticks: list[int]) -> tuple[float, float]:
        """How far the plan's motion is when the last of `states` is reached, and how fast it runs there, 1 being plan speed."""
        at_s = min(ticks[-1] * TICK_S, motion.total_s)
        if np.hypot(*(self._steps(motion, np.array([at_s]))[0] - self._exact(states[-1]))) <= _ON_TIME_STEPS:
            return at_s, 1.0
        # Slowed down somewhere: follow the board through the motion, which is behind its own time.
        look_s = np.arange(0.0, at_s + _LOOK_EVERY_S, _LOOK_EVERY_S)
        way = self._steps(motion, look_s)
        places, place = [0], 0
        for state, before, now in zip(states[1:], ticks, ticks[1:], strict=False):
            furthest = min(now * TICK_S, look_s[place] + 3 * (now - before) * TICK_S + _CATCH_UP_S)
            near = way[place : int(furthest / _LOOK_EVERY_S) + 2]
            place += int(np.hypot(*(near - self._exact(state)).T).argmin())
            places.append(place)
        begin = max(i for i in range(len(ticks) - 1) if i == 0 or ticks[-1] - ticks[i] >= _PACE_OVER_S / TICK_S)
        pace = (look_s[places[-1]] - look_s[places[begin]]) / ((ticks[-1] - ticks[begin]) * TICK_S)
        return min(float(look_s[place]), motion.total_s), float(np.clip(pace, 0.05, 1.0))

    def _steps(self, motion: Motion, at_s: Array) -> Array:
        return self._setup.kinematics.steps(motion.sample(at_s)[0] - self._setup.origin_mm)

    def _exact(self, state: State) -> Array:
        """Where the motors are, in steps, with the fraction that the accumulators hold."""
        if "LT" not in self._setup.firmware.motion:
            return np.array(state.position, dtype=np.float64)
        return np.array(state.position) + np.array(state.acc) / ONE_STEP - 0.5


def _length_mm(motion: Motion, to_s: float) -> float:
    """How far the pen goes along the motion until this time."""
    points = motion.sample(np.append(np.arange(0.0, to_s, _LOOK_EVERY_S), to_s))[0]
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def _paced(motion: Motion, pace: float) -> Motion:
    """The motion at a steady `pace` of its own speed, its pieces still whole ticks."""
    duration_s = np.maximum(np.rint(motion.duration_s / pace / TICK_S), 1.0) * TICK_S
    share = (motion.duration_s / duration_s)[:, None]
    return Motion(
        duration_s,
        motion.position_mm,
        motion.velocity_mm_s * share,
        motion.acceleration_mm_s2 * share**2,
        motion.jerk_mm_s3 * share**3,
        motion.end_mm,
    )
