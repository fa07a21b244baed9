"""How long a program takes, exactly: the board's own ticks, counted by what the pen does meanwhile."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from output.ebb.arithmetic import TICK_S
from output.ebb.command_file import Line
from output.ebb.commands import Command
from output.ebb.firmware import Firmware
from output.ebb.program import Mark
from output.ebb.replay import PEN, Replay, Rows


@dataclass(slots=True)
class Times:
    """Seconds of board time: moving or waiting with the pen down, with the pen up, and while the servo is given time."""

    duration_s: float = 0.0
    pen_down_s: float = 0.0
    pen_up_s: float = 0.0
    pen_lift_s: float = 0.0

    def add(self, ticks: int, pen_ticks: int, down_ticks: int) -> None:
        self.duration_s += ticks * TICK_S
        self.pen_lift_s += pen_ticks * TICK_S
        self.pen_down_s += down_ticks * TICK_S
        self.pen_up_s += (ticks - pen_ticks - down_ticks) * TICK_S


@dataclass(slots=True)
class LayerTimes(Times):
    """The times of one layer, by the layer marks; commands before the first mark belong to layer 0."""

    number: int = 0
    name: str = ""


@dataclass(slots=True)
class Estimate(Times):
    """Of a whole program, without the waits for an operator; `slowed_s` of it are for a queue that always holds enough."""

    commands: int = 0
    pen_lifts: int = 0
    slowed_s: float = 0.0
    layers: list[LayerTimes] = field(default_factory=list)


class Tally:
    """Adds rows up."""

    def __init__(self) -> None:
        self.total = Times()
        self.layers: dict[int, LayerTimes] = {}

    def add(self, rows: Rows) -> None:
        wall = rows.ticks + rows.dead
        pen = rows.kind == PEN
        down = rows.pen_down & ~pen
        for layer in np.unique(rows.layer):
            here = rows.layer == layer
            counts = int(wall[here].sum()), int(wall[here & pen].sum()), int(wall[here & down].sum())
            self.total.add(*counts)
            self.layers.setdefault(int(layer), LayerTimes(number=int(layer))).add(*counts)

    def estimate(self, replay: Replay) -> Estimate:
        for number, layer in self.layers.items():
            layer.name = replay.layer_names.get(number, "")
        t = self.total
        return Estimate(
            t.duration_s, t.pen_down_s, t.pen_up_s, t.pen_lift_s,
            replay.commands, replay.pen_lifts, sum(mark.lost_s for mark in replay.slowed), list(self.layers.values()),
        )  # fmt: skip


def estimate(program: Iterable[Command | Mark | Line], firmware: Firmware) -> Estimate:
    """Board time of a program from its first command to its last, provided that the queue never runs dry."""
    replay, tally = Replay(program, firmware), Tally()
    for rows in replay.rows():
        tally.add(rows)
    return tally.estimate(replay)
