"""Host, board and motion queue in time: how far ahead of the motion each command arrives.

The host sends a command when the one before it was answered (`host_s` later at the board); the board takes `service_s` to
parse and queue it, longer the faster the motors step; a full queue makes it wait. Command i is queued at q_i, starts at s_i
and ends at e_i:

    q_i = max(q_{i-1} + host_s + service_i, s_{i - depth})      the place that i takes is free when i - depth starts
    s_i = max(e_{i-1}, q_i),   e_i = s_i + duration_i

The lead of command i is e_{i-1} - q_i: how long the board still has to do when it gets it. A negative lead is a stop of that
length, and a stutter when the motors were moving.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from output.ebb.firmware import Firmware

Array = NDArray[np.float64]

# What a well-behaved host takes from a command's answer to the next command's arrival: two USB frames of 1 ms.
HOST_S = 0.002
# How much motion is wanted in a queue that is deep enough for it: pieces are merged for that, and a motion that merging leaves
# too dense is slowed down.
LEAD_S = 1.0
# Places of a deep queue that the streamer leaves free, so that a stop is always heard.
FREE_PLACES = 2
# Standing still, in mm/s: running dry at less is no stutter.
STILL_MM_S = 0.05


@dataclass(frozen=True, slots=True)
class QueueSetup:
    """`depth` places of the motion queue are used; `host_s` passes between an answer and the next command."""

    depth: int
    host_s: float = HOST_S


def queue_setup(firmware: Firmware, host_s: float = HOST_S) -> QueueSetup:
    """What the streamer uses of this firmware's queue: all but FREE_PLACES of a deep one."""
    depth = firmware.queue_max - FREE_PLACES if firmware.queue_max > FREE_PLACES else firmware.queue_max
    return QueueSetup(depth, host_s)


def service_s(firmware: Firmware, name: str, load: Array) -> Array:
    """How long the board takes to parse and queue a command while its motors step at `load` (n,), 0 to 1 of both at 25 kHz."""
    idle, busy = firmware.service_ms.get(name, firmware.service_ms["other"])
    return np.asarray((idle + (busy - idle) * np.clip(load, 0.0, 1.0)) / 1000)


@dataclass(slots=True)
class QueueForecast:
    """Feed it commands in order; it keeps what it needs of the past. Places are of the queue: a TD is fed as two.

    `lowest_lead_s`, before command `lowest_at`, is the lowest lead in motion once the queue has been full; of all motion while
    it has not. (An empty queue takes its time to fill, however long the commands are.) Underruns are counted from the start.
    `full_from` is the place among those fed last from which the queue had been full.
    """

    setup: QueueSetup
    lowest_lead_s: float = np.inf
    lowest_at: int = -1
    has_been_full: bool = False
    full_from: int = 0
    underruns: int = 0
    starved_s: float = 0.0
    first_underruns: list[tuple[int, float]] = field(default_factory=list)
    _queued_s: float = 0.0
    _end_s: float = 0.0
    _started: list[float] = field(default_factory=list)
    _count: int = 0

    def copy(self) -> QueueForecast:
        """The same queue, to try something on."""
        return replace(self, _started=list(self._started), first_underruns=list(self.first_underruns))

    def feed(self, command: NDArray[np.int64], takes_s: Array, duration_s: Array, speed_mm_s: Array) -> Array:
        """Leads (n,) in seconds of the commands numbered `command`, each with what host and board take for it, its duration and
        the speed at which the motion passes its start. The lowest lead and the underruns are of motion that goes on."""
        depth = self.setup.depth
        queued, end, ring = self._queued_s, self._end_s, self._started or [0.0] * depth
        place = self._count % depth
        leads = np.empty(len(command))
        filled = 0 if self.has_been_full else len(command)
        for i, (takes, lasts) in enumerate(zip(takes_s.tolist(), duration_s.tolist(), strict=True)):
            queued += takes
            free = ring[place]
            if free > queued:
                queued = free
                if i < filled:
                    filled = i
            leads[i] = end - queued
            start = end if end > queued else queued
            ring[place] = start
            end = start + lasts
            place += 1
            if place == depth:
                place = 0
        self._queued_s, self._end_s, self._started, self.full_from = queued, end, ring, filled
        self._count += len(command)
        self._note(command, leads, speed_mm_s, filled)
        return leads

    def _note(self, command: NDArray[np.int64], leads: Array, speed_mm_s: Array, filled: int) -> None:
        moving = speed_mm_s > STILL_MM_S
        if filled < len(command) and not self.has_been_full:
            self.has_been_full, self.lowest_lead_s, self.lowest_at = True, np.inf, -1
        shown = np.where(moving, leads, np.inf)
        counted = shown[filled:] if self.has_been_full else shown
        if len(counted) and counted.min() < self.lowest_lead_s:
            lowest = len(command) - len(counted) + int(np.argmin(counted))
            self.lowest_lead_s, self.lowest_at = float(leads[lowest]), int(command[lowest])
        dry = np.flatnonzero(shown < 0)
        if not len(dry):
            return
        self.underruns += len(dry)
        self.starved_s -= float(shown[dry].sum())
        for i in dry[: 5 - len(self.first_underruns)]:
            self.first_underruns.append((int(command[i]), float(-leads[i])))
