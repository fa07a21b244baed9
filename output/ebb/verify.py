"""What a board would draw from a program, and whether it should be sent.

The program is played through the firmware's exact arithmetic; speeds, accelerations and jerks are those of the rates that the
motors get, in machine millimetres, between commands as well as within them. Positions are the step counters' where the pen
rests, and the accumulators' fraction of a step is used in between.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from output.ebb.arithmetic import ONE_STEP, TICK_S
from output.ebb.command_file import Line
from output.ebb.commands import Command
from output.ebb.estimate import Tally
from output.ebb.firmware import Firmware
from output.ebb.program import Mark
from output.ebb.queue_forecast import QueueForecast, QueueSetup, queue_setup, service_s
from output.ebb.replay import MOVE, PEN, Replay, Rows
from output.ebb.reversals import Reversals
from output.ebb.verify_compare import Comparison, compare
from output.wording import counted
from planning.motion.limits import Kinematics

__all__ = ["Comparison", "Report", "compare", "verify"]

Array = NDArray[np.float64]

# How far (mm) a chord may be off the curve between the points of a stroke.
_CHORD_MM = 0.003
_MOST_POINTS = 256
# Steps that one motor would have taken while it waits for the other's last: old firmware's coarse rates make it a few.
_WAITING_STEPS = 4.0
# A row that ends slower than this ends at rest.
_REST_MM_S = 0.01
# How far (mm) the way may leave the machine's reach: rounding to steps.
_SLACK_MM = 0.05
# Jumps of speed (mm/s) between commands. Staircases of 14 to 86 are usual, and steppers follow, though they can be heard; at
# 80 steps per mm and 1/16 steps, 120 mm/s is a start at 600 full steps a second, which no loaded stepper of this size survives.
_HEARD_MM_S = 10.0
_LOST_MM_S = 120.0
# A command that lasts longer than this is more likely a mistake than a move.
_LONG_COMMAND_S = 600.0


@dataclass(slots=True)
class Report:
    """Lengths in mm, times in board seconds; positions in machine millimetres, `final_steps` in physical steps from the start
    of the counters. `bounds_mm` (left, top, right, bottom) is of the ink, `travel_bounds_mm` of everything.

    `lowest_lead_s` is the least motion that is queued while the pen moves, once the queue of `queue_depth` has been full, or at
    any time when it never is (`queue_filled` False). For that `slowed_motions` last `slowed_s` longer in all than planned, some
    pieces `slowed_most` times as long.
    `problems` are reasons not to send it, `warnings` are not. `strokes` are the pen-down polylines, each (n, 2).
    """

    firmware: str
    duration_s: float = 0.0
    pen_down_s: float = 0.0
    pen_up_s: float = 0.0
    pen_lift_s: float = 0.0
    pen_down_mm: float = 0.0
    pen_up_mm: float = 0.0
    pen_lifts: int = 0
    commands: int = 0
    max_speed_mm_s: float = 0.0
    max_acceleration_mm_s2: float = 0.0
    max_jerk_mm_s3: float = 0.0
    max_velocity_jump_mm_s: float = 0.0
    max_velocity_jump_at: int = -1
    max_step_rate_hz: float = 0.0
    backward_steps: int = 0
    final_position_mm: tuple[float, float] = (0.0, 0.0)
    final_steps: tuple[int, int] = (0, 0)
    pen_down_at_end: bool = False
    bounds_mm: tuple[float, float, float, float] | None = None
    travel_bounds_mm: tuple[float, float, float, float] | None = None
    predicted_underruns: int = 0
    predicted_starved_s: float = 0.0
    lowest_lead_s: float | None = None
    lowest_lead_at: int = -1
    queue_depth: int = 1
    queue_filled: bool = False
    slowed_motions: int = 0
    slowed_s: float = 0.0
    slowed_most: float = 1.0
    shortest_command_ms: float | None = None
    problems: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    strokes: list[Array] = field(default_factory=list, repr=False)

    @property
    def sendable(self) -> bool:
        return not self.problems

    @property
    def constant(self) -> Literal["speed", "acceleration", "jerk"]:
        """What is constant within every command, and changes in jumps between them: the derivatives after it mean nothing."""
        if not self.max_acceleration_mm_s2:
            return "speed"
        return "jerk" if self.max_jerk_mm_s3 else "acceleration"

    def as_dict(self) -> dict[str, Any]:
        """Everything but the strokes, for JSON."""
        values = asdict(self)
        del values["strokes"]
        return {**values, "stroke_count": len(self.strokes), "sendable": self.sendable, "constant": self.constant}


def verify(
    program: Iterable[Command | Mark | Line],
    firmware: Firmware,
    kinematics: Kinematics,
    origin_mm: Array | tuple[float, float] = (0.0, 0.0),
    *,
    travel_mm: tuple[float, float, float, float] | None = None,
    queue: QueueSetup | None = None,
    microsteps: int = 1,
    keep_strokes: bool = True,
    problems: list[str] | None = None,
) -> Report:
    """Replay `program` on `firmware`. `origin_mm` is the machine position at which the program starts, its counters at 0.

    `travel_mm` (left, top, right, bottom) is the machine's reach, None for no such check. `problems` found before (syntax
    errors while the file is read) are taken over when the program has been read to its end. Memory grows with the strokes only;
    `keep_strokes=False` leaves them out.
    """
    replay = Replay(program, firmware, microsteps=microsteps)
    check = _Check(firmware, kinematics, np.asarray(origin_mm, dtype=np.float64), queue or queue_setup(firmware), keep_strokes)
    for rows in replay.rows():
        check.add(rows)
    return check.report(replay, [*(problems or []), *replay.problems], travel_mm)


class _Check:
    """Gathers a report from rows."""

    def __init__(
        self, firmware: Firmware, kinematics: Kinematics, origin_mm: Array, queue: QueueSetup, keep_strokes: bool
    ) -> None:
        self.firmware = firmware
        self.to_steps = kinematics.steps_per_mm.T
        self.to_mm = np.linalg.inv(kinematics.steps_per_mm).T
        self.origin_mm = origin_mm
        self.keep_strokes = keep_strokes
        self.queue = QueueForecast(queue)
        self.tally = Tally()
        self.reversals = Reversals()
        self.result = Report(firmware.name, queue_depth=queue.depth)
        self.last_velocity = np.zeros(2)
        self.last_rate = np.zeros((1, 2))
        self.ink = _Box()
        self.way = _Box()
        self.shortest_s = np.inf
        self.last_point: Array | None = None
        self.stroke: list[Array] = []

    def add(self, rows: Rows) -> None:
        self.tally.add(rows)
        self.reversals.add(rows)
        t = rows.ticks[:, None].astype(np.float64)
        still = (rows.kind != MOVE)[:, None]
        v0 = np.where(still, 0.0, rows.r0 + rows.accel / 2 - rows.jerk / 6)
        v1 = v0 + t * (rows.accel + t * rows.jerk / 2)
        # A lowering in the midst of a motion takes one tick: the motion goes on.
        before = np.vstack((self.last_rate, v1[:-1]))
        passing = (rows.kind == PEN) & (rows.ticks <= 1)
        v0[passing] = v1[passing] = before[passing]
        self.last_rate = v1[-1:]
        scale = 1 / (ONE_STEP * TICK_S)
        start, end = (v0 @ self.to_mm) * scale, (v1 @ self.to_mm) * scale
        self._motion(rows, start, end)
        speeds = self._jumps(rows, start, end)
        self._queue(rows, np.maximum(np.abs(v0), np.abs(v1)).sum(axis=1) / (2 * ONE_STEP), speeds)
        self._path(rows, end)

    def _motion(self, rows: Rows, start: Array, end: Array) -> None:
        r = self.result
        lasts = rows.ticks * TICK_S
        a0 = (rows.accel @ self.to_mm) / (ONE_STEP * TICK_S**2)
        jerk = (rows.jerk @ self.to_mm) / (ONE_STEP * TICK_S**3)
        a1 = a0 + jerk * lasts[:, None]
        r.max_acceleration_mm_s2 = max(r.max_acceleration_mm_s2, _longest(a0), _longest(a1))
        r.max_jerk_mm_s3 = max(r.max_jerk_mm_s3, _longest(jerk))
        speed = max(_longest(start), _longest(end))
        # Speed peaks inside a row only where it first speeds up and then slows down.
        peaks = ((start * a0).sum(axis=1) > 0) & ((end * a1).sum(axis=1) < 0)
        for share in np.linspace(0.0, 1.0, 9)[1:-1] if peaks.any() else ():
            s = (lasts[peaks] * share)[:, None]
            speed = max(speed, _longest(start[peaks] + s * (a0[peaks] + s * jerk[peaks] / 2)))
        r.max_speed_mm_s = max(r.max_speed_mm_s, speed)
        rates = np.maximum(np.abs(start @ self.to_steps), np.abs(end @ self.to_steps)).max(initial=0.0)
        r.max_step_rate_hz = max(r.max_step_rate_hz, float(rates))
        moving = rows.kind == MOVE
        if moving.any():
            self.shortest_s = min(self.shortest_s, float((lasts + rows.dead * TICK_S)[moving].min()))
        if (lasts > _LONG_COMMAND_S).any():
            at = int(rows.command[np.argmax(lasts)])
            r.warnings.append(f"command {at + 1} lasts {lasts.max():.0f} s by itself")

    def _jumps(self, rows: Rows, start: Array, end: Array) -> Array:
        """Velocity jumps at the rows' starts; returns the speed that goes on over each border."""
        # A motor that has taken its last step of an LM or SM waits for the other's: a few steps' time is no stop.
        start, end = start @ self.to_steps, end @ self.to_steps
        goes_on = (np.diff(rows.command) == 0) & (rows.dead[:-1] == 0)
        lost = np.abs(end[:-1]) * (rows.ticks[1:] * TICK_S)[:, None]
        stands = (rows.r0[1:] == 0) & (rows.accel[1:] == 0) & (rows.jerk[1:] == 0)
        waits = np.vstack((np.zeros((1, 2), dtype=np.bool_), goes_on[:, None] & stands & (lost < _WAITING_STEPS)))
        start, end = (np.where(waits, np.roll(end, 1, axis=0), rate) @ self.to_mm for rate in (start, end))
        before = np.vstack((self.last_velocity[None, :], end[:-1]))
        jumps = np.hypot(*(start - before).T)
        at = int(np.argmax(jumps))
        if jumps[at] > self.result.max_velocity_jump_mm_s:
            self.result.max_velocity_jump_mm_s = float(jumps[at])
            self.result.max_velocity_jump_at = int(rows.command[at])
        self.last_velocity = end[-1]
        return np.asarray(np.minimum(np.hypot(*start.T), np.hypot(*before.T)))

    def _queue(self, rows: Rows, load: Array, speeds: Array) -> None:
        # One entry per command, but two for a TD, whose second half costs neither host nor parser anything.
        first = np.concatenate(([True], np.diff(rows.command) != 0))
        entry = first | (rows.dead > 0) & np.concatenate(([False], rows.dead[:-1] > 0))
        starts = np.flatnonzero(entry)
        lasts = np.add.reduceat((rows.ticks + rows.dead) * TICK_S, starts)
        takes = self.queue.setup.host_s + self._service(rows, load)
        self.queue.feed(rows.command[starts], np.where(first, takes, 0.0)[starts], lasts, speeds[starts])

    def _service(self, rows: Rows, load: Array) -> Array:
        motion = rows.kind == MOVE
        name = "T3" if "T3" in self.firmware.motion else "LM" if "LM" in self.firmware.motion else "SM"
        return np.where(motion, service_s(self.firmware, name, load), service_s(self.firmware, "SP", load))

    def _path(self, rows: Rows, end: Array) -> None:
        """Lengths, bounds and strokes, along points close enough that their chords are the curve."""
        lasts = rows.ticks * TICK_S
        a0 = rows.accel @ self.to_mm / (ONE_STEP * TICK_S**2)
        a1 = a0 + rows.jerk @ self.to_mm / (ONE_STEP * TICK_S**3) * lasts[:, None]
        sag_mm = np.maximum(np.hypot(*a0.T), np.hypot(*a1.T)) * lasts**2 / 8
        moves = (rows.kind == MOVE) & (rows.r0.any(axis=1) | rows.accel.any(axis=1) | rows.jerk.any(axis=1))
        count = np.where(moves, np.clip(np.ceil(np.sqrt(sag_mm / _CHORD_MM)), 1, _MOST_POINTS), 0).astype(np.int64)
        owner = np.repeat(np.arange(len(rows)), count)
        place = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count) + 1
        share = place / count[owner]
        steps = (rows.phase[owner] + _moved(rows, owner, rows.ticks[owner] * share)) / ONE_STEP
        # Where the pen rests, the step counters are the truth; in motion the smooth curve that they follow.
        rests = (place == count[owner]) & (np.hypot(*end.T) < _REST_MM_S)[owner]
        steps[rests] = rows.counter[owner[rests] + 1]
        begin = self._mm(rows.counter[:1].astype(np.float64)) if self.last_point is None else self.last_point
        points = np.vstack((begin, self._mm(steps)))
        self.last_point = points[-1:]

        lengths = np.hypot(*np.diff(points, axis=0).T)
        inked = rows.pen_down[owner]
        self.result.pen_down_mm += float(lengths[inked].sum())
        self.result.pen_up_mm += float(lengths[~inked].sum())
        self.way.add(points)
        self._strokes(rows, points[1:], np.concatenate(([0], np.cumsum(count))))

    def _strokes(self, rows: Rows, points: Array, offset: NDArray[np.int64]) -> None:
        """Cut the points where the pen goes up or down. `offset` (n + 1,): where each row's points begin."""
        borders = np.concatenate(([0], np.flatnonzero(np.diff(rows.pen_down)) + 1, [len(rows)]))
        for first, last in zip(borders[:-1].tolist(), borders[1:].tolist(), strict=True):
            if not rows.pen_down[first]:
                self._close()
                continue
            if not self.stroke:
                self.stroke.append(self._mm(rows.counter[first : first + 1].astype(np.float64)))
            self.stroke.append(points[offset[first] : offset[last]])

    def _close(self) -> None:
        if self.stroke:
            whole = np.vstack(self.stroke)
            self.ink.add(whole)
            if self.keep_strokes:
                self.result.strokes.append(whole)
            self.stroke = []

    def _mm(self, steps: Array) -> Array:
        return np.asarray(steps @ self.to_mm + self.origin_mm)

    def report(self, replay: Replay, problems: list[str], travel_mm: tuple[float, float, float, float] | None) -> Report:
        """The finished report."""
        self._close()
        r, times, queue = self.result, self.tally.total, self.queue
        r.duration_s, r.pen_down_s, r.pen_up_s, r.pen_lift_s = (
            times.duration_s, times.pen_down_s, times.pen_up_s, times.pen_lift_s,
        )  # fmt: skip
        r.pen_lifts, r.commands, r.backward_steps = replay.pen_lifts, replay.commands, self.reversals.count
        r.final_steps = replay.counters()
        x, y = self._mm(np.array([r.final_steps], dtype=np.float64))[0]
        r.final_position_mm = (float(x), float(y))
        r.pen_down_at_end = replay.pen_down
        r.bounds_mm, r.travel_bounds_mm = self.ink.bounds, self.way.bounds
        r.predicted_underruns, r.predicted_starved_s = queue.underruns, queue.starved_s
        if np.isfinite(queue.lowest_lead_s):
            r.lowest_lead_s, r.lowest_lead_at, r.queue_filled = queue.lowest_lead_s, queue.lowest_at, queue.has_been_full
        if np.isfinite(self.shortest_s):
            r.shortest_command_ms = self.shortest_s * 1000
        r.problems, r.warnings = problems, [*r.warnings, *replay.warnings]
        r.slowed_motions, r.slowed_s = len(replay.slowed), sum(mark.lost_s for mark in replay.slowed)
        r.slowed_most = max((mark.most for mark in replay.slowed), default=1.0)
        self._judge(travel_mm)
        return r

    def _judge(self, travel_mm: tuple[float, float, float, float] | None) -> None:
        r = self.result
        if not r.commands and not r.problems:
            r.problems.append("there is no command in it; give a command file, as `plotter export` writes")
        if r.predicted_underruns:
            at, lack = self.queue.first_underruns[0]
            r.problems.append(
                f"the board would run dry {counted(r.predicted_underruns, 'time')} in motion, first before command {at + 1} "
                f"for {lack * 1000:.1f} ms; export for this firmware ({self.firmware.name}) with longer pieces"
            )
        if r.max_velocity_jump_mm_s > _HEARD_MM_S:
            jump = f"the speed jumps by {r.max_velocity_jump_mm_s:.1f} mm/s at command {r.max_velocity_jump_at + 1}"
            if r.max_velocity_jump_mm_s > _LOST_MM_S:
                r.problems.append(f"{jump}: beyond {_LOST_MM_S:.0f} mm/s motors lose steps; speed up and slow down in between")
            else:
                r.warnings.append(f"{jump}: the motors follow, but can be heard and felt")
        if r.pen_down_at_end:
            r.problems.append("the pen is still down at the end, and would stay on the paper: end with SP,1")
        if travel_mm is not None and r.travel_bounds_mm is not None:
            reach, way = np.array(travel_mm), np.array(r.travel_bounds_mm)
            if (way[:2] < reach[:2] - _SLACK_MM).any() or (way[2:] > reach[2:] + _SLACK_MM).any():
                said = [", ".join(f"{value:.2f}" for value in box) for box in (way, reach)]
                r.problems.append(
                    f"it goes to {said[0]} mm (left, top, right, bottom), the machine reaches {said[1]}; move or shrink it"
                )


class _Box:
    """The bounds of points."""

    def __init__(self) -> None:
        self.low, self.high = np.full(2, np.inf), np.full(2, -np.inf)

    def add(self, points: Array) -> None:
        self.low, self.high = np.minimum(self.low, points.min(axis=0)), np.maximum(self.high, points.max(axis=0))

    @property
    def bounds(self) -> tuple[float, float, float, float] | None:
        if not np.isfinite(self.low).all():
            return None
        return (float(self.low[0]), float(self.low[1]), float(self.high[0]), float(self.high[1]))


def _moved(rows: Rows, row: NDArray[np.int64], tick: Array) -> Array:
    """How far (2^-31 steps) each of the rows `row` has gone after `tick` ticks, as a smooth curve."""
    t = tick[:, None]
    r0, accel, jerk = rows.r0[row], rows.accel[row], rows.jerk[row]
    return np.asarray(t * (r0 + accel / 2 - jerk / 6 + t * (accel / 2 + t * jerk / 6)))


def _longest(vectors: Array) -> float:
    return float(np.hypot(*vectors.T).max(initial=0.0))
