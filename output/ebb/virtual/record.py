"""What the virtual board did: ink, pen, moves, gaps, blocked parser, bytes. Written while it runs, put together when asked.

Positions are motor steps of the paper: they go on where CS or EM set the board's own counters back to zero, and stay where
they are while the motors have no power. Times are board ticks of 40 us since power-on.
"""

from __future__ import annotations

import json
from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from output.ebb.virtual.moves import PenMove, QueueEntry, StepperMove
from output.ebb.virtual.registers import ONE_STEP, TICKS_PER_S

if TYPE_CHECKING:
    from output.ebb.virtual.motion import AxisRun, MotionQueue, Running
    from output.ebb.virtual.servo import Servo

INK_SAMPLE_TICKS = 25  # 1 ms
_AXIS_FIELDS = 8  # r0, a, j, acc, base, sign, end, moves
_ROW = 2 + 2 * _AXIS_FIELDS
_LONGEST_VECTORED = 1 << 20  # ticks for which j t^3 still fits the closed form in int64
_WARM_UP = 32  # stepper commands after a standstill that do not count for the lowest lead
_NO_END = 1 << 62
_REST_RATE = ONE_STEP // 2500  # ten steps a second
_MOST_SAMPLES = 20_000


@dataclass(frozen=True, slots=True)
class Gap:
    """The queue ran dry between two stepper moves: `ticks` long from `tick`. `pen_down` as commanded; `rates` at the stop."""

    tick: int
    ticks: int
    pen_down: bool
    rates: tuple[int, int]

    @property
    def in_motion(self) -> bool:
        """A stutter on paper: the pen was down, or the motors were still turning."""
        return self.pen_down or any(self.rates)


@dataclass(slots=True)
class PenEvent:
    """The servo was sent to `target`: from `position` at `tick`, there at `arrival`. `up` as QP reports it.

    As commanded, the pen is `lowered` or lifted from `counts_from` on: at once, but a pen that is lowered in the midst of a
    motion is down only when it touches. On a low lift it is neither up nor lowered.
    """

    tick: int
    up: bool
    position: float
    target: int
    arrival: int
    counts_from: int
    lowered: bool


@dataclass(slots=True)
class Recorder:
    """Collects while the board runs; cheap for each command, and no sampling before `strokes` is asked for."""

    keep_wire: bool = True
    rows: array[int] = field(default_factory=lambda: array("q"))
    slow: dict[int, tuple[AxisRun, AxisRun]] = field(default_factory=dict)
    paper: list[int] = field(default_factory=lambda: [0, 0])
    pen_events: list[PenEvent] = field(default_factory=list)
    touch_changes: list[tuple[int, bool]] = field(default_factory=list)
    gaps: list[Gap] = field(default_factory=list)
    lowest_lead_ticks: int | None = None
    blocked: list[tuple[int, int]] = field(default_factory=list)
    commands: int = 0
    queue_pushes: int = 0
    stepper_moves: int = 0
    first_motion: int | None = None
    last_motion: int | None = None
    largest_rate: int = 0
    largest_rate_jump: int = 0
    wire: list[tuple[int, str, str]] = field(default_factory=list)
    notes: list[tuple[int, str]] = field(default_factory=list)
    _previous_stepper: bool = False
    _last_rates: tuple[int, int] = (0, 0)
    _since_standstill: int = 0

    # ---- told by the board

    def command(self, tick: int, line: bytes) -> None:
        self.commands += 1
        if self.keep_wire:
            self.wire.append((tick, ">", line.decode("latin-1")))

    def reply(self, tick: int, data: bytes) -> None:
        if self.keep_wire:
            self.wire.append((tick, "<", data.decode("latin-1")))

    def note(self, tick: int, text: str) -> None:
        """Something from outside: a fault, the button, the supply."""
        self.notes.append((tick, text))

    def servo_changed(self, tick: int, servo: Servo, *, brief: bool = False) -> None:
        """`brief`: the queue does not wait for it."""
        counts_from = tick
        if brief and not servo.up and self._previous_stepper and max(map(abs, self._last_rates)) > _REST_RATE:
            counts_from = servo.touch_change() or tick
        position, arrival = servo.position(tick), servo.travel_end()
        self.pen_events.append(PenEvent(tick, servo.up, position, servo.target, arrival, counts_from, servo.lowered))
        while self.touch_changes and self.touch_changes[-1][0] > tick:
            self.touch_changes.pop()
        touching = servo.touches(servo.position(tick))
        if touching != (bool(self.touch_changes) and self.touch_changes[-1][1]):
            self.touch_changes.append((tick, touching))
        change = servo.touch_change()
        if change is not None and change > tick:
            self.touch_changes.append((change, not touching))

    def queued(self, entry: QueueEntry, lead_ticks: int, idle: bool) -> None:
        self.queue_pushes += 1
        if not isinstance(entry, StepperMove):
            return
        self._since_standstill = 0 if idle else self._since_standstill + 1
        if self._since_standstill > _WARM_UP and (self.lowest_lead_ticks is None or lead_ticks < self.lowest_lead_ticks):
            self.lowest_lead_ticks = lead_ticks

    def parser_was_blocked(self, since: int, until: int) -> None:
        self.blocked.append((since, until))

    def loaded(self, tick: int, entry: QueueEntry, motion: MotionQueue) -> None:
        if not isinstance(entry, StepperMove):
            return
        self.stepper_moves += 1
        if self.first_motion is None:
            self.first_motion = tick
        gap = tick - motion.idle_since
        start_rates = motion.rates(tick)
        if gap and self._previous_stepper:
            down = bool(self.pen_events) and self.pen_events[-1].lowered
            self.gaps.append(Gap(motion.idle_since, gap, down, self._last_rates))
        before = (0, 0) if gap or not self._previous_stepper else self._last_rates
        jump = max(abs(start_rates[0] - before[0]), abs(start_rates[1] - before[1]))
        self.largest_rate_jump = max(self.largest_rate_jump, jump)

    def ended(self, tick: int, entry: QueueEntry) -> None:
        if isinstance(entry, PenMove) and entry.ticks <= 1:
            return  # a pen that is lowered in the midst of a motion: the motion goes on
        self._previous_stepper = isinstance(entry, StepperMove)
        if self._previous_stepper:
            self.last_motion = tick
        elif isinstance(entry, PenMove):
            self._last_rates = (0, 0)

    def stopped(self, tick: int) -> None:
        """ES or a limit switch: what follows is no continuation."""
        if self._previous_stepper or self.last_motion is not None:
            self.last_motion = tick
        self._previous_stepper = False
        self._last_rates = (0, 0)

    def counters_cleared(self) -> None:
        """The board's counters are zero again; the paper's go on."""

    def ran(self, running: Running, ticks: int, *, moving: bool) -> None:
        axes = running.axes
        assert axes is not None
        self.rows.extend((running.loaded, ticks))
        vectored = True
        rates = []
        for axis, run in enumerate(axes):
            ramp = run.ramp
            simple = not (ramp.a or ramp.j) or (ticks <= _LONGEST_VECTORED and ramp.exact_until(ticks))
            vectored = vectored and simple and ramp.mask is None
            end = _NO_END if run.end is None else run.end
            self.rows.extend((ramp.r0, ramp.a, ramp.j, run.acc, self.paper[axis], run.sign, end, moving))
            if moving:
                self.paper[axis] += run.at(ticks)[0] - run.position
            rates.append(run.rate(min(ticks, end)) if ticks and end >= ticks else 0)
            self.largest_rate = max(self.largest_rate, abs(rates[-1]), abs(run.rate(1)))
        if not vectored:
            self.slow[len(self.rows) // _ROW - 1] = axes
        self._last_rates = (rates[0], rates[1])

    # ---- asked afterwards

    def _table(self) -> NDArray[np.int64]:
        return np.frombuffer(self.rows, dtype=np.int64).reshape(-1, _ROW) if self.rows else np.zeros((0, _ROW), np.int64)

    def positions(self, ticks: NDArray[np.int64]) -> NDArray[np.int64]:
        """Paper positions in motor steps at board `ticks` (n,) ascending: (n, 2)."""
        table = self._table()
        out = np.zeros((len(ticks), 2), np.int64)
        if not len(table):
            return out
        index = np.searchsorted(table[:, 0], ticks, side="right") - 1
        for start in range(0, len(ticks), 200_000):
            part = slice(start, start + 200_000)
            out[part] = _positions(table, index[part], ticks[part])
        for row, axes in self.slow.items():
            for k in np.flatnonzero(index == row):
                t = int(min(ticks[k] - table[row, 0], table[row, 1]))
                for axis, run in enumerate(axes):
                    base, moves = table[row, 2 + axis * _AXIS_FIELDS + 4], table[row, 2 + axis * _AXIS_FIELDS + 7]
                    out[k, axis] = base + moves * (run.at(t)[0] - run.position)
        return out

    def intervals(self, *, touching: bool, now: int) -> list[tuple[int, int]]:
        """(from, to) ticks with the pen down: as commanded, or with the servo's travel (`touching`)."""
        touched = [(tick, down) for tick, down in self.touch_changes if tick <= now]
        changes = touched if touching else self._commanded()
        found: list[tuple[int, int]] = []
        since: int | None = None
        for tick, down in changes:
            if down and since is None:
                since = tick
            elif not down and since is not None:
                found.append((since, tick))
                since = None
        if since is not None:
            found.append((since, now))
        return found

    def _commanded(self) -> list[tuple[int, bool]]:
        changes = []
        for event, after in zip(self.pen_events, [*self.pen_events[1:], None], strict=True):
            tick = event.counts_from if after is None else min(event.counts_from, after.tick)
            if tick == event.counts_from or (after and after.lowered):
                changes.append((tick, event.lowered))
        return changes

    def _sample_ticks(self) -> NDArray[np.int64]:
        """Each millisecond of every stretch, and its ends; a stretch of more than 20 s is sampled in 20,000 places."""
        table = self._table()
        if not len(table):
            return np.zeros(0, np.int64)
        step = np.maximum(table[:, 1] // (_MOST_SAMPLES * INK_SAMPLE_TICKS), 1) * INK_SAMPLE_TICKS
        first = -(-table[:, 0] // step)
        counts = np.maximum((table[:, 0] + table[:, 1]) // step - first + 1, 0)
        offsets = np.repeat(np.cumsum(counts) - counts, counts)
        grid = (np.repeat(first, counts) + np.arange(int(counts.sum())) - offsets) * np.repeat(step, counts)
        return np.concatenate((grid, table[:, 0], table[:, 0] + table[:, 1]))

    def strokes(self, *, touching: bool, now: int) -> list[dict[str, Any]]:
        """One entry per lowering: `down_tick`, `up_tick`, `ticks` and `points` (motor steps) where the position changed."""
        return self._strokes([self.intervals(touching=touching, now=now)])[0]

    def _strokes(self, traces: list[list[tuple[int, int]]]) -> list[list[dict[str, Any]]]:
        bounds = np.array([tick for intervals in traces for pair in intervals for tick in pair], dtype=np.int64)
        ticks = np.sort(np.concatenate((self._sample_ticks(), bounds)))
        ticks = ticks[np.concatenate(([True], np.diff(ticks) > 0))] if len(ticks) else ticks
        points = self.positions(ticks)
        moved = np.concatenate(([True], (np.diff(points, axis=0) != 0).any(axis=1)))
        found: list[list[dict[str, Any]]] = []
        for intervals in traces:
            found.append([])
            for down, up in intervals:
                first, last = np.searchsorted(ticks, down), np.searchsorted(ticks, up, side="right")
                keep = moved[first:last].copy()
                keep[:1] = True
                stroke = {"down_tick": down, "up_tick": up, "ticks": ticks[first:last][keep].tolist()}
                found[-1].append({**stroke, "points": points[first:last][keep].tolist()})
        return found

    def moves(self) -> list[list[int]]:
        """Each executed stretch of a stepper move: start tick, ticks, and paper positions at its start and end."""
        table = self._table()
        if not len(table):
            return []
        ends = self.positions_at_ends(table)
        base = table[:, [2 + 4, 2 + _AXIS_FIELDS + 4]]
        return [list(map(int, row)) for row in np.column_stack((table[:, :2], base, ends))]

    def positions_at_ends(self, table: NDArray[np.int64]) -> NDArray[np.int64]:
        """Paper positions after each stretch (n, 2): where the next one starts, and where the paper is now."""
        base = table[:, [2 + 4, 2 + _AXIS_FIELDS + 4]]
        return np.concatenate((base[1:], np.array([self.paper], np.int64)))

    def summary(self, now: int) -> dict[str, Any]:
        """All of the record as plain values."""
        stutters = [gap for gap in self.gaps if gap.in_motion]
        first, last = self.first_motion, self.last_motion
        commanded, touching = self._strokes([self.intervals(touching=kind, now=now) for kind in (False, True)])
        return {
            "ticks_per_s": TICKS_PER_S,
            "now_tick": now,
            "commands": self.commands,
            "stepper_moves": self.stepper_moves,
            "first_motion_tick": first,
            "last_motion_tick": last,
            "motion_ticks": 0 if first is None or last is None else last - first,
            "underruns": len(stutters),
            "underrun_ticks": sum(gap.ticks for gap in stutters),
            "gaps": [[gap.tick, gap.ticks, gap.pen_down, *gap.rates] for gap in self.gaps],
            "lowest_lead_ticks": self.lowest_lead_ticks,
            "parser_blocked": [[since, until] for since, until in self.blocked],
            "largest_step_rate_hz": self.largest_rate * TICKS_PER_S / ONE_STEP,
            "largest_step_rate_jump_hz": self.largest_rate_jump * TICKS_PER_S / ONE_STEP,
            "pen_events": [[e.tick, "up" if e.up else "down", e.position, e.target, e.arrival] for e in self.pen_events],
            "paper_position": list(self.paper),
            "notes": [list(note) for note in self.notes],
            "moves": self.moves(),
            "ink": commanded,
            "ink_touching": touching,
            "wire": [list(line) for line in self.wire],
        }

    def write(self, path: Path, now: int, state: dict[str, Any]) -> None:
        """The record and the board's `state` as JSON; complete when it appears under `path`."""
        partial = path.with_name(path.name + ".partial")
        partial.write_text(json.dumps({**state, **self.summary(now)}, separators=(",", ":")))
        partial.replace(path)


def _positions(table: NDArray[np.int64], index: NDArray[np.intp], ticks: NDArray[np.int64]) -> NDArray[np.int64]:
    """The closed form of the step interrupt, vectored; int64 products may wrap, their sums do not."""
    rows = table[np.maximum(index, 0)]
    ran = np.where(index < 0, 0, np.minimum(ticks - rows[:, 0], rows[:, 1]))
    out = np.empty((len(ticks), 2), np.int64)
    for axis in (0, 1):
        r0, a, j, acc, base, sign, end, moves = rows[:, 2 + axis * _AXIS_FIELDS : 2 + (axis + 1) * _AXIS_FIELDS].T
        t = np.minimum(ran, end)
        pairs = t * (t + 1) // 2
        triples = ((t - 1) * t // 2) * (t + 1) // 3
        with np.errstate(over="ignore"):
            phase = acc + r0 * t + a * pairs + j * triples
        out[:, axis] = base + moves * sign * (phase >> 31)
    return out
