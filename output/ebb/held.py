"""A plan's program that can be held in the middle of a motion: the pen slows down along its path, stops, and lifts.

The board is far behind the program: what has been sent will be executed, so a hold begins with the first command that has not
been sent. What the board's counters and accumulators will be there is known exactly, by the firmware's arithmetic; how far the
plan's motion is there follows from the time that has passed in it, or, where commands take longer than the plan's pieces, from
the place. From there on the motion is replaced by one that comes to rest on the same path (planning.motion.hold).

    actions --encode--> items   0 1 2 [3 4 5 6 7 8] 9 ...          one action's items, in brackets
                              taken = 6:   ^ state, plan time      -> [brake] lift

A travel to a stroke is held in the same way, up to the place where its pen begins to be lowered. Having begun, the lowering
would be over before the travel that is slowed down: the travel is finished then, and the pen raised before it draws.

Clocks: plan time of an action's motion, and board ticks since the action began. The program is made in the streamer's planning
thread and held from its loop; the log between them has a lock.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from output.ebb import arithmetic, arithmetic_old
from output.ebb.arithmetic import ONE_STEP, STILL, Executed, State
from output.ebb.commands import SP, Command, MotionCommand
from output.ebb.encode import BoardSetup, Encoder, epilogue
from output.ebb.producer import BUFFER_ITEMS
from output.ebb.program import Mark, Program, StrokeMark
from output.ebb.resume import Place
from output.errors import BadCommand
from planning.motion.hold import run_out, stop_on_line, stop_on_path
from planning.motion.limits import Limits
from planning.motion.plan import TICK_S, Action, Draw, Lift, Lower, Motion, Travel, joined_motion, still

Array = NDArray[np.float64]

# The program is made at most so many items ahead of what is sent; what lies further back can no longer be asked for.
_AHEAD = BUFFER_ITEMS + 64
# A place this near (steps) to where the plan's own time says is there; else commands take longer than the plan's pieces.
_ON_TIME_STEPS = 1.5
# A motion that runs at less than this of plan speed is held from the speed that it really has.
_FULL_PACE = 0.98
_LEAST_PACE = 0.05
# How finely a slowed motion is followed, and how much further than its command's time it may be found.
_LOOK_EVERY_S = 0.0002
_CATCH_UP_S = 0.01
# By this factor at most the board is ahead of the motion's time, where commands end with their last step.
_AHEAD_OF_TIME = 1.1
# Slower than this (steps per second) a motion has no pace that could be told.
_CREEPING_STEPS_S = 100.0
# A travel with less than this part of its speed across its way is straight.
_STRAIGHT = 1e-6


@dataclass(slots=True)
class _Followed:
    """A motion whose items have been made, or are being made: a draw or a part of one, or a travel to a stroke and the pen's
    lowering there.

    `first` is the number of its first item; `states[i]`, `rates[i]` and `ticks[i]` are the board's state, each motor's rate in
    2^-31 steps per tick, and the time since the motion began after i of them.
    """

    first: int
    motion: Motion
    stroke: int
    states: list[State]
    rates: list[tuple[int, int]] = field(default_factory=lambda: [(0, 0)])
    ticks: list[int] = field(default_factory=lambda: [0])

    @property
    def end(self) -> int:
        """The number of the item after those that have been made."""
        return self.first + len(self.ticks) - 1


@dataclass(slots=True)
class _Drawn(_Followed):
    """`before_mm` of its stroke was drawn before it; `last` says that the stroke ends with it."""

    last: bool = True
    before_mm: float = 0.0


@dataclass(slots=True)
class _Approached(_Followed):
    """`on_the_way`: the pen begins to be lowered before the motion's end. `lowers` and `arrived` are the numbers of the first
    item that lowers it, and of the first after the motion, once they are made."""

    on_the_way: bool = False
    lowers: int | None = None
    arrived: int | None = None


class PausableProgram:
    """`before`, the commands of `actions`, and the epilogue; an iterable for one run. `hold` stops it on the path.

    `limits` are for the XY motion of draws, `travel_limits` for each motor's in travel. After a hold, `place` is where the pen
    comes to rest: on or before which stroke, where the motors stand, and how much is drawn.
    """

    def __init__(
        self,
        before: Program,
        actions: Iterable[Action],
        setup: BoardSetup,
        limits: Limits,
        travel_limits: Limits,
        lift_s: float,
    ) -> None:
        self.place: Place | None = None
        self._before = before
        self._actions = actions
        self._setup = setup
        self._limits = limits
        self._travel_limits = travel_limits
        self._lift_s = lift_s
        self._execute = arithmetic_old.execute if setup.firmware.old_arithmetic else arithmetic.execute
        self._lock = threading.Lock()
        self._followed: deque[_Drawn | _Approached] = deque()
        self._made = 0

    def __iter__(self) -> Iterator[Command | Mark]:
        for item in self._before:
            self._made += 1
            yield item
        encoder = Encoder(self._setup)
        stroke, before_mm = -1, 0.0
        for action, lower in _approaches(self._actions):
            if isinstance(action, Travel) and lower is not None:
                stroke, before_mm = lower.stroke, 0.0
                yield from self._approaching(action, lower, encoder)
            elif isinstance(action, Draw) and action.stroke == stroke:
                rates = self._followed[-1].rates[-1:] if before_mm else [(0, 0)]
                drawn = _Drawn(self._made, action.motion, stroke, [encoder.state], rates, last=action.last, before_mm=before_mm)
                for item in self._following(drawn, encoder.action(action)):
                    self._made += 1
                    yield item
                before_mm += _length_mm(action.motion, action.motion.total_s)
            else:
                for item in encoder.action(action):
                    self._made += 1
                    yield item
        yield from epilogue(self._setup)

    def _approaching(self, travel: Travel, lower: Lower, encoder: Encoder) -> Iterator[Command | Mark]:
        """The items of a travel to a stroke and of the lowering there, as one motion that can be held."""
        yield from encoder.motion(still(travel.motion.start_mm))  # nothing, but the encoder's state is that of the start now
        on_the_way = travel.lower_at_s is not None and encoder.family.lowers_in_motion
        approach = _Approached(self._made, travel.motion, lower.stroke, [encoder.state], on_the_way=on_the_way)
        for item in self._following(approach, chain(encoder.action(travel), encoder.action(lower))):
            with self._lock:
                if isinstance(item, SP) and approach.lowers is None:
                    approach.lowers = self._made
                if isinstance(item, StrokeMark):
                    approach.arrived = self._made
            self._made += 1
            yield item

    def _following(self, motion: _Drawn | _Approached, items: Iterable[Command | Mark]) -> Iterator[Command | Mark]:
        """The items of a motion, with what the board will be at after each."""
        state, rates = motion.states[0], motion.rates[0]
        with self._lock:
            self._followed.append(motion)
            while len(self._followed) > 2 and self._followed[1].first + _AHEAD < self._made:
                self._followed.popleft()
        for item in items:
            ticks = 0
            if isinstance(item, MotionCommand):
                done = self._execute(item, state)
                state, ticks, rates = done.state, done.ticks, _end_rates(done)
            with self._lock:
                motion.states.append(state)
                motion.rates.append(rates)
                motion.ticks.append(motion.ticks[-1] + ticks)
            yield item

    def hold(self, taken: int) -> Program | None:
        """What to send in place of everything from item number `taken` on: braking on the path, and pen up.

        None while no line is being drawn there and no stroke travelled to, or the end of either is too near to stop before it;
        and where no motion that goes on from there can be encoded, which is no reason to end a plot that can pause at the end.
        """
        with self._lock:
            now = [motion for motion in self._followed if motion.first < taken <= motion.end]
            if not now:
                return None
            motion, count = now[-1], taken - now[-1].first
            # A copy: the planning thread goes on with the lists.
            until = count + 1
            motion = replace(motion, states=motion.states[:until], rates=motion.rates[:until], ticks=motion.ticks[:until])
            parts = [
                part
                for part in self._followed
                if isinstance(part, _Drawn) and part.stroke == motion.stroke and part.first >= motion.first
            ]
        try:
            return self._hold_draw(motion, parts) if isinstance(motion, _Drawn) else self._hold_travel(motion, taken)
        except BadCommand:
            return None

    def _hold_draw(self, drawn: _Drawn, parts: list[_Drawn]) -> Program | None:
        motion = joined_motion([part.motion for part in parts])
        at_s, pace = self._plan_time(motion, drawn)
        paced = motion if pace >= _FULL_PACE else _paced(motion, pace)
        try:
            stopping, end_s = stop_on_path(paced, _time_in(paced, motion, at_s), self._limits)
        except ValueError:
            if parts[-1].last:
                raise
            return None  # it would come to rest on a part of the stroke that has not been planned yet
        end_s = _time_in(motion, paced, end_s)
        if not len(stopping) or end_s >= motion.total_s - TICK_S:
            return None
        items, steps = self._stopped(stopping, drawn)
        drawn_mm = drawn.before_mm + _length_mm(motion, end_s)
        scale = float(np.sqrt(abs(np.linalg.det(self._setup.kinematics.steps_per_mm))))
        self.place = Place(0, drawn.stroke, False, steps, drawn_mm * scale, drawn.stroke)
        return items

    def _hold_travel(self, approach: _Approached, taken: int) -> Program | None:
        """Braking on the way, or, where the pen is on its way down, the rest of the way; and the pen raised in any case."""
        stopping, motion = still(approach.motion.end_mm), approach.motion
        if approach.arrived is None or taken < approach.arrived:
            at_s, pace = self._plan_time(motion, approach)
            paced = motion if pace >= _FULL_PACE else _paced(motion, pace)
            from_s = _time_in(paced, motion, at_s)
            lowering = approach.lowers is not None and taken > approach.lowers
            brake = None if lowering else self._braked(paced, from_s)
            if brake is None and not approach.on_the_way:
                return None  # at the stroke's mark the stream itself can wait, the pen being up
            stopping = run_out(paced, from_s)[0] if brake is None else brake
        elif not approach.on_the_way and taken == approach.arrived:
            return None
        items, steps = self._stopped(stopping, approach)
        self.place = Place(0, None, False, steps, 0.0, approach.stroke)
        return items

    def _stopped(self, stopping: Motion, followed: _Followed) -> tuple[list[Command | Mark], tuple[int, int]]:
        """The items of a motion that goes on from the last of what was followed, and of the lift; and where the motors are."""
        encoder = Encoder(self._setup, followed.states[-1])
        if len(stopping):
            encoder.reached = self._steps(stopping, np.zeros(1))[0] * ONE_STEP
            encoder.rates = np.array(followed.rates[-1], dtype=np.float64)
        items: list[Command | Mark] = [*encoder.motion(stopping), *encoder.action(Lift(self._lift_s))]
        return items, encoder.state.position

    def _plan_time(self, motion: Motion, followed: _Followed) -> tuple[float, float]:
        """How far the plan's `motion` is after the last of the items that were followed, and how fast the board runs there, 1
        being plan speed."""
        states, ticks = followed.states, followed.ticks
        at_s = min(ticks[-1] * TICK_S, motion.total_s)
        if np.hypot(*(self._steps(motion, np.array([at_s]))[0] - self._exact(states[-1]))) <= _ON_TIME_STEPS:
            return at_s, 1.0
        # Slowed down somewhere, and the board is behind the motion's own time; or ahead of it, where commands end with their
        # last step: follow the board through the motion.
        look_s = np.arange(0.0, min(_AHEAD_OF_TIME * at_s + _CATCH_UP_S, motion.total_s) + _LOOK_EVERY_S, _LOOK_EVERY_S)
        way = self._steps(motion, look_s)
        place = 0
        for state, before, now in zip(states[1:], ticks, ticks[1:], strict=False):
            furthest = look_s[place] + 3 * (now - before) * TICK_S + _CATCH_UP_S
            near = way[place : int(furthest / _LOOK_EVERY_S) + 2]
            place += int(np.hypot(*(near - self._exact(state)).T).argmin())
        at_s = min(float(look_s[place]), motion.total_s)
        planned = self._setup.kinematics.steps_per_mm @ motion.sample(np.array([at_s]))[1][0]
        really = np.array(followed.rates[-1]) / (ONE_STEP * TICK_S)
        if np.hypot(*planned) < _CREEPING_STEPS_S:
            return at_s, 1.0
        return at_s, float(np.clip(really @ planned / (planned @ planned), _LEAST_PACE, 1.0))

    def _braked(self, travel: Motion, from_s: float) -> Motion | None:
        """The travel brought to rest on its way; None where it ends before that. Along a straight one both motors together may
        do more than `travel_limits` allow in every direction."""
        way, limits = travel.end_mm - travel.start_mm, self._travel_limits
        length = np.hypot(*way)
        beside = np.abs(travel.velocity_mm_s @ np.array([-way[1], way[0]])).max(initial=0.0)
        if length == 0.0 or beside > _STRAIGHT * length * limits.speed_mm_s:
            stopping, end_s = stop_on_path(travel, from_s, limits)
            return None if end_s >= travel.total_s - TICK_S else stopping
        rows = self._setup.kinematics.steps_per_mm
        share = float((np.abs(rows @ way) / (length * np.linalg.norm(rows, axis=1))).max())
        speed, acceleration, jerk = limits.speed_mm_s / share, limits.acceleration_mm_s2 / share, limits.jerk_mm_s3 / share
        return stop_on_line(travel, from_s, Limits(speed, acceleration, jerk, limits.tolerance_mm))

    def _steps(self, motion: Motion, at_s: Array) -> Array:
        return self._setup.kinematics.steps(motion.sample(at_s)[0] - self._setup.origin_mm)

    def _exact(self, state: State) -> Array:
        """Where the motors are, in steps, with the fraction that the accumulators hold."""
        if "LT" not in self._setup.firmware.motion:
            return np.array(state.position, dtype=np.float64)
        return np.array(state.position) + np.array(state.acc) / ONE_STEP - 0.5


def _approaches(actions: Iterable[Action]) -> Iterator[tuple[Action, Lower | None]]:
    """Each action by itself, but a travel to a stroke together with the lowering that follows it."""
    travel: Travel | None = None
    for action in actions:
        lower = action if isinstance(action, Lower) else None
        if travel is not None:
            yield travel, lower
            travel = None
            if lower is not None:
                continue
        if isinstance(action, Travel):
            travel = action
        else:
            yield action, None
    if travel is not None:
        yield travel, None


def _end_rates(done: Executed) -> tuple[int, int]:
    """Each motor's rate in the last tick in which it moved."""
    rates = [0, 0]
    for segment in done.segments:
        for axis, profile in enumerate(segment.profile):
            if profile != STILL:
                rates[axis] = profile.rate(segment.ticks)
    return rates[0], rates[1]


def _length_mm(motion: Motion, to_s: float) -> float:
    """How far the pen goes along the motion until this time."""
    points = motion.sample(np.append(np.arange(0.0, to_s, _LOOK_EVERY_S), to_s))[0]
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def _time_in(one: Motion, other: Motion, at_s: float) -> float:
    """When a motion is where another of the same pieces, each at a steady pace of its own, is at `at_s`."""
    one_s, other_s = (np.concatenate(([0.0], np.cumsum(motion.duration_s))) for motion in (one, other))
    return float(np.interp(at_s, other_s, one_s))


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
