"""The motion queue and the command that is being executed: step positions and accumulators at any tick.

A command is loaded at a tick and takes its steps in the ticks after it; at the tick of its end the next one is loaded, so
that there is no gap while the queue holds something. After idling, a command is loaded in the tick after it was queued.
Positions are those of the step counters, as executed up to the asked tick; nothing queued is included.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from output.ebb.virtual.moves import QueueEntry, StepperMove
from output.ebb.virtual.registers import ONE_STEP, PHASE_MASK, Ramp, int32, ticks_to_take


@dataclass(slots=True)
class AxisRun:
    """One axis of the command being executed: from `position` and `acc`, along `ramp`, until tick `end` (None: never)."""

    ramp: Ramp
    acc: int
    position: int
    sign: int
    steps: int
    end: int | None

    def at(self, t: int) -> tuple[int, int]:
        """Position and accumulator after t ticks of the command."""
        if self.end is not None and t > self.end:
            t = self.end
        phase = self.acc + self.ramp.total(t)
        return self.position + self.sign * (phase >> 31), phase & PHASE_MASK

    def rate(self, t: int) -> int:
        """Signed rate at tick t, zero once the axis has stopped."""
        if t < 1 or (self.end is not None and t > self.end):
            return 0
        return self.sign * self.ramp.rate(t)


@dataclass(slots=True)
class Running:
    """The command being executed. `end` is the tick (of the board) at which the next one is loaded; None: it never ends."""

    entry: QueueEntry
    loaded: int
    end: int | None
    axes: tuple[AxisRun, AxisRun] | None


@dataclass(slots=True)
class MotionQueue:
    """FIFO of `depth` entries, the command in execution, and the counters they change.

    `on_load` is told of each entry as it starts, `on_run` of each stretch of a stepper move that was executed
    (the axes as they started, first tick, ticks), `on_idle_end` of each load that came after an idle time.
    """

    depth: int = 1
    entries: deque[tuple[QueueEntry, int]] = field(default_factory=deque)
    running: Running | None = None
    position: list[int] = field(default_factory=lambda: [0, 0])
    acc: list[int] = field(default_factory=lambda: [0, 0])
    stale_steps: list[int] = field(default_factory=lambda: [0, 0])
    idle_since: int = 0
    on_load: Callable[[QueueEntry, int], None] = lambda _entry, _tick: None
    on_end: Callable[[QueueEntry, int], None] = lambda _entry, _tick: None
    on_run: Callable[[Running, int], None] = lambda _running, _ticks: None

    @property
    def full(self) -> bool:
        return len(self.entries) >= self.depth

    @property
    def idle(self) -> bool:
        return self.running is None and not self.entries

    def push(self, entry: QueueEntry, tick: int) -> None:
        """Queue `entry` at `tick`; the caller has seen that there is room."""
        self.entries.append((entry, tick))

    def next_event(self) -> int | None:
        """The next tick at which something is loaded or ends, or None."""
        if self.running is not None:
            return self.running.end
        if self.entries:
            return max(self.idle_since, self.entries[0][1]) + 1
        return None

    def step_event(self, tick: int) -> None:
        """Do what happens at `tick`, which is the tick that `next_event` gave."""
        if self.running is not None:
            ending = self.running
            self._settle(ending, tick)
            self.running = None
            self.idle_since = tick
            self.on_end(ending.entry, tick)
        if self.entries:
            entry, _ = self.entries.popleft()
            self._load(entry, tick)

    def _load(self, entry: QueueEntry, tick: int) -> None:
        if isinstance(entry, StepperMove):
            for axis, value in enumerate(entry.clear):
                if value is not None:
                    self.acc[axis] = value
            axes = (self._axis(entry, 0), self._axis(entry, 1))
            self.running = Running(entry, tick, self._end(entry, axes, tick), axes)
            if entry.ticks is None:
                self.stale_steps = [0, 0]
        else:
            self.running = Running(entry, tick, tick + entry.ticks, None)
        self.on_load(entry, tick)

    def _axis(self, entry: StepperMove, axis: int) -> AxisRun:
        ramp, steps = entry.ramps[axis], entry.steps[axis]
        end = entry.ticks if entry.ticks is not None else ticks_to_take(steps, ramp, self.acc[axis])
        return AxisRun(ramp, self.acc[axis], self.position[axis], entry.signs[axis], steps, end)

    @staticmethod
    def _end(entry: StepperMove, axes: tuple[AxisRun, AxisRun], tick: int) -> int | None:
        if entry.ticks is not None:
            return tick + entry.ticks + entry.dead_ticks
        ends = [axis.end for axis in axes]
        if None in ends:
            return None
        return tick + max(1, *(end for end in ends if end is not None))

    def _settle(self, running: Running, tick: int) -> None:
        """Bring the counters to what `running` has done up to `tick`."""
        if running.axes is None:
            return
        t = self._executed(running, tick)
        for axis, run in enumerate(running.axes):
            self.position[axis], self.acc[axis] = run.at(t)
        self.on_run(running, t)

    @staticmethod
    def _executed(running: Running, tick: int) -> int:
        t = tick - running.loaded
        entry = running.entry
        if isinstance(entry, StepperMove) and entry.ticks is not None:
            return min(t, entry.ticks)
        return t

    def state(self, tick: int) -> tuple[list[int], list[int]]:
        """Positions and accumulators as executed at `tick`."""
        running = self.running
        if running is None or running.axes is None:
            return [int32(p) for p in self.position], list(self.acc)
        t = self._executed(running, tick)
        (p1, a1), (p2, a2) = running.axes[0].at(t), running.axes[1].at(t)
        return [int32(p1), int32(p2)], [a1, a2]

    def rates(self, tick: int) -> tuple[int, int]:
        """Signed rate registers at `tick`, zero when nothing steps."""
        running = self.running
        if running is None or running.axes is None:
            return 0, 0
        t = max(1, self._executed(running, tick))
        return running.axes[0].rate(t), running.axes[1].rate(t)

    def remaining(self, tick: int) -> tuple[int, int]:
        """The counts whose being nonzero makes the motor bits of QG and QM."""
        running = self.running
        if running is None:
            return 0, 0
        entry = running.entry
        if not isinstance(entry, StepperMove) or running.axes is None:
            return self.stale_steps[0], self.stale_steps[1]
        t = self._executed(running, tick)
        if entry.ticks is not None:
            return entry.ticks - t, self.stale_steps[1]
        left = [0, 0]
        for axis, run in enumerate(running.axes):
            if run.steps and (run.end is None or t < run.end):
                left[axis] = max(1, run.steps - abs(run.at(t)[0] - run.position))
        return left[0], left[1]

    def waiting_ticks(self, tick: int) -> int:
        """Roughly the ticks until the board would run dry: what is left of the running command and what is queued."""
        running = self.running
        lead = 0 if running is None or running.end is None else running.end - tick
        return lead + sum(_about(entry) for entry, _ in self.entries)

    def abort(self, tick: int) -> bool:
        """Drop the running command and the queue; True if a stepper move was running or something was queued."""
        interrupted = bool(self.entries)
        self.entries.clear()
        running = self.running
        if running is not None:
            if running.axes is not None:
                interrupted = True
                self.stale_steps = list(self.remaining(tick))
                self._settle(running, tick)
            self.running = None
            self.idle_since = tick
        return interrupted

    def split(self, tick: int) -> None:
        """End the stretch of the running stepper move at `tick` and go on with the rest of it as a new stretch."""
        running = self.running
        if running is None or running.axes is None:
            return
        t = self._executed(running, tick)
        self._settle(running, tick)
        rest = tuple(
            AxisRun(
                run.ramp.after(t),
                self.acc[axis],
                self.position[axis],
                run.sign,
                max(0, run.steps - abs(self.position[axis] - run.position)),
                None if run.end is None else max(0, run.end - t),
            )
            for axis, run in enumerate(running.axes)
        )
        entry = running.entry
        assert isinstance(entry, StepperMove)
        left = None if entry.ticks is None else entry.ticks - t
        shortened = StepperMove(
            entry.command, (rest[0].ramp, rest[1].ramp), (None, None), left, entry.steps, entry.signs, entry.dead_ticks
        )
        self.running = Running(shortened, tick, running.end, (rest[0], rest[1]))

    def clear_counters(self, tick: int) -> None:
        """CS, and the clearing part of EM: positions and accumulators to zero, even inside a move."""
        self.split(tick)
        self.position = [0, 0]
        self.acc = [0, 0]
        running = self.running
        if running is None or running.axes is None:
            return
        entry = running.entry
        assert isinstance(entry, StepperMove)
        for run in running.axes:
            run.acc = run.position = 0
            if entry.ticks is None:
                run.end = ticks_to_take(run.steps, run.ramp, 0)
        running.end = self._end(entry, running.axes, tick)


def _about(entry: QueueEntry) -> int:
    if isinstance(entry, StepperMove):
        return entry.about_ticks if entry.ticks is None else entry.ticks + entry.dead_ticks
    return entry.ticks


def acc_after_clear(ramp: Ramp) -> int:
    """What the Clear parameter of LM, L3, LT, T3 and TD leaves in an accumulator."""
    return ONE_STEP - 1 if ramp.starts_negative() else 0
