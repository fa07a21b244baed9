"""One class for each family of motion commands: borders of a motion in, commands out, the board's state carried along."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from output.ebb import arithmetic, arithmetic_old, encode_quadratic
from output.ebb.arithmetic import ONE_STEP, STILL, TICK_S, TICKS_PER_MS, Executed, State
from output.ebb.commands import SM, T3, TD, XM, Command, MotionCommand
from output.ebb.encode_merge import merge
from output.ebb.encode_pieces import LONGEST_TICKS, Borders, Parameters, Phase, quantised, split, stretched
from output.ebb.encode_slow import bent, rises, slowed, slowness, too_fast
from output.ebb.encode_spans import Samples, cut, on_milliseconds, sampled, without_short_end
from output.ebb.firmware import Firmware
from output.ebb.program import Mark, Slowed
from output.ebb.queue_forecast import HOST_S, LEAD_S, STILL_MM_S, QueueForecast, queue_setup, service_s
from output.errors import BadCommand
from planning.motion.limits import Kinematics

Array = NDArray[np.float64]

# How far (2^-31 steps) a piece may be beside the plan because it slows down or speeds up within it.
_BENT = 0.05 * ONE_STEP
# Rounds in which a motion is slowed down, and by how much (a factor) a piece must be too fast to be worth one more.
_ROUNDS, _ENOUGH = 24, 1.002
# What follows is not known, and may shorten the lead by so much.
_SPARE = 1.02
# By this factor a piece is slowed down that would step faster than the board can, as its ends are and it is not.
_OVERSHOT = 1.005
# Old firmware computes SM's rates so coarsely that one or two steps may take 2 % longer than the move: where a motor would wait
# for them for longer than it takes for this many of its own, they are left to the next move.
_FEW_STEPS, _WAITED_STEPS = 2, 1.0


@dataclass(frozen=True, slots=True)
class Sizing:
    """How long pieces are made. Where the depth allows, pieces are merged until `lead_s` of motion is queued, and a motion is
    slowed down until `least_lead_s` is. Merging may move the pen `merge_steps` off the plan, and parabolas (LT, LM) or lines
    (SM, XM) `lt_steps` or `sm_steps`; beyond `worst_steps` times these, a motion is slowed down instead. `host_s` is what the
    host takes from one answer to the next command.
    """

    lead_s: float = LEAD_S
    least_lead_s: float = LEAD_S
    merge_steps: float = 0.4
    lt_steps: float = 0.5
    sm_steps: float = 1.0
    worst_steps: float = 3.0
    host_s: float = HOST_S


class Family(ABC):
    """Base: the state that the board will have, and a model of its queue.

    `lowers_in_motion`: other commands may stand in the queue between two of a motion's, which may then be encoded in parts.
    `changes_speed`: a command may begin at one speed and end at another.
    """

    lowers_in_motion = False
    changes_speed = True

    def __init__(self, firmware: Firmware, kinematics: Kinematics, sizing: Sizing) -> None:
        self.firmware = firmware
        self.sizing = sizing
        self.state = State()
        self.queue = QueueForecast(queue_setup(firmware, sizing.host_s))
        self.to_mm = np.linalg.inv(kinematics.steps_per_mm).T / ONE_STEP
        self.count = 0
        # How many times as slow as planned the part of a stroke ended that the next motion goes on from; None at rest.
        self.begun: float | None = None

    @abstractmethod
    def motion(self, borders: Borders, last: bool = True) -> Iterator[Command | Mark]:
        """The commands of a motion, or of a part of one that goes on from the part before; moves `state` on."""

    def waited(self, name: str, duration_s: float) -> None:
        """A wait or a pen move goes into the queue."""
        takes = self.sizing.host_s + service_s(self.firmware, name, np.zeros(1))
        self.queue.feed(np.zeros(1, dtype=np.int64), takes, np.array([duration_s]), np.zeros(1))

    def load(self, rates: Array) -> Array:
        """How busy both motors keep the board, 0 to 1, at rates (n, 2)."""
        return np.asarray(np.abs(rates).sum(axis=1) / (2 * ONE_STEP))

    def sustainable_ticks(self, name: str, borders: Borders) -> int:
        """The shortest command of this motion that can be streamed for ever: host, parser, and a tenth for safety."""
        busiest = self.load(borders.v).max(initial=0.0)
        takes_s = self.sizing.host_s + float(service_s(self.firmware, name, np.array([busiest]))[0])
        return int(np.ceil(1.1 * max(takes_s, self.firmware.least_ms[name] / 1000) / TICK_S))

    def slowing(self, planned: Borders, slower: Borders) -> Slowed:
        """What is said when a motion is slowed down."""
        lost_s = (int(slower.ticks.sum()) - int(planned.ticks.sum())) * TICK_S
        return Slowed(lost_s, float((slower.ticks / planned.ticks).max()))


class Cubic(Family):
    """T3, and TD for the two halves of a ramp where `pairs`: one command for each cubic."""

    lowers_in_motion = True

    def __init__(self, firmware: Firmware, kinematics: Kinematics, sizing: Sizing, pairs: bool) -> None:
        super().__init__(firmware, kinematics, sizing)
        self.pairs = pairs
        # How long what was queued last takes; nothing before the beginning was ever too short.
        self.queued_s = [np.inf] * self.queue.setup.depth

    def motion(self, borders: Borders, last: bool = True) -> Iterator[Command | Mark]:
        merged = split(merge(borders, self.sizing.merge_steps, self._lacking, self.to_mm))
        merged, chosen = self._sustained(merged, last)
        if chosen is not merged:
            yield self.slowing(merged, chosen)
        self.begun = None if last else slowness(merged, chosen)
        self._remember(np.asarray((chosen.ticks + self.firmware.dead_ticks) * TICK_S, dtype=np.float64))
        (one, two), (acc1, acc2) = self.state
        phase = Phase(one * ONE_STEP + acc1, two * ONE_STEP + acc2)
        rows = quantised(chosen, phase)
        yield from _paired(rows) if self.pairs else (T3(*row) for row in rows)
        self.state = State(phase.steps, (phase.axis1 & (ONE_STEP - 1), phase.axis2 & (ONE_STEP - 1)))

    def waited(self, name: str, duration_s: float) -> None:
        super().waited(name, duration_s)
        self._remember(np.array([duration_s]))

    def _remember(self, lasts_s: Array) -> None:
        depth = self.queue.setup.depth
        self.queued_s = [*self.queued_s, *lasts_s[-depth:].tolist()][-depth:]

    def _lacking(self, ticks: NDArray[np.int64]) -> Array:
        """By which share of what is wanted the queues are short, in the mean, that each piece of a motion lies in when some

        piece comes, of the motion or after it."""
        depth = self.queue.setup.depth
        # What comes after the motion is not known yet: it will be neither better nor worse than is wanted.
        after = np.full(depth, self.sizing.lead_s / depth)
        lasts = np.concatenate((self.queued_s, (ticks + self.firmware.dead_ticks) * TICK_S, after))
        # What is queued when a piece comes are the `depth` pieces before it.
        total = np.concatenate(([0.0], np.cumsum(np.minimum(lasts, self.sizing.lead_s))))
        short = np.maximum(self.sizing.lead_s * (1 - 1e-9) - (total[depth:] - total[:-depth]), 0.0) / self.sizing.lead_s
        near = np.concatenate(([0.0], np.cumsum(short)))
        place = np.arange(len(ticks))
        return np.asarray(near[place + depth + 1] - near[place + 1]) / depth

    def _sustained(self, borders: Borders, ends: bool) -> tuple[Borders, Borders]:
        """The motion, and slowed down where the queue would run dry or hold too little; moves the queue on."""
        sustained, depth = self.sustainable_ticks("T3", borders), self.queue.setup.depth
        most, need, rise = self._most_slowed(borders), np.ones(len(borders)), rises(borders)
        chosen, stretch = (borders, None) if self.begun in (None, 1.0) else slowed(borders, need, rise, self.begun)
        for _ in range(_ROUNDS):
            model, dry, short = self._queue_after(chosen, ends)
            longer = chosen.ticks / borders.ticks
            # All that was queued when it held too little, in proportion; what is too short of it where it ran dry.
            lacks = _greatest(short[1:], depth)
            wanted = np.where(lacks > 1.0, np.minimum(longer * lacks, most), 1.0)
            ran_dry = _greatest(np.append(dry, np.zeros(depth)), depth + 1) > 0
            wanted = np.maximum(wanted, np.where(ran_dry, sustained / borders.ticks, 1.0))
            wanted = np.maximum(wanted, np.where(too_fast(chosen), longer * _OVERSHOT, 1.0))
            gentle = rise
            if stretch is not None and (astray := bent(borders, chosen) / _BENT).max() > 1.0:
                gentle = np.where(astray > 1.0, np.abs(np.diff(1 / stretch)) * 0.9 / astray.clip(1.0), rise)
            if gentle is rise and not (wanted > need * _ENOUGH).any():
                break
            need, rise = np.maximum(need, wanted), gentle
            chosen, stretch = slowed(borders, need, rise, self.begun)
        else:
            model = self._queue_after(chosen, ends)[0]
        self.queue = model
        return borders, chosen

    def _most_slowed(self, borders: Borders) -> Array:
        """How many times as long each piece (n,) need be at most: as neighbours that fill a queue, all slowed alike, would.

        At the motion's ends, as those of them that are its own would.
        """
        n, depth = len(borders), self.queue.setup.depth
        total = np.concatenate(([0], np.cumsum(borders.ticks + self.firmware.dead_ticks))) * TICK_S
        first = np.arange(1 - depth, n)
        last = np.minimum(first + depth, n)
        first = np.maximum(first, 0)
        return _greatest((last - first) * _SPARE * self.sizing.least_lead_s / depth / (total[last] - total[first]), depth)

    def _queue_after(self, borders: Borders, ends: bool) -> tuple[QueueForecast, NDArray[np.bool_], Array]:
        """The queue after the motion, at which of its pieces it would have run dry, and by what factor the part of the motion
        that is queued then would have to last longer to be enough.

        The last (n + depth,) at the pieces that follow in the queue too: where the motion goes on, they last as long as they
        should. Where more than half of what is queued is theirs, the part that they belong to will see to it.
        """
        depth, least = self.queue.setup.depth, _SPARE * self.sizing.least_lead_s
        model = self.queue.copy()
        takes = self.sizing.host_s + service_s(self.firmware, "T3", self.load(borders.v[:-1]))
        lasts = np.asarray((borders.ticks + self.firmware.dead_ticks) * TICK_S, dtype=np.float64)
        speeds = np.asarray(np.hypot(*(borders.v[:-1] @ self.to_mm).T) / TICK_S)
        leads = model.feed(np.zeros(len(borders), dtype=np.int64), takes, lasts, speeds)
        moving = speeds > STILL_MM_S
        counts = moving & (np.arange(len(borders)) >= model.full_from)
        counts = np.append(counts, (np.arange(depth) < depth // 2) & model.has_been_full)
        after = np.full(depth, np.inf)  # what follows a motion's end is not known, and lacks nothing
        if not ends:
            places = np.zeros(depth)
            after = model.copy().feed(places.astype(np.int64), places + takes[-1], places + least / depth, places)
        total, place = np.concatenate(([0.0], np.cumsum(lasts))), np.arange(len(counts))
        own = total[np.minimum(place, len(lasts))] - total[np.clip(place - depth, 0, len(lasts))]
        lacks = np.where(counts, least - np.append(leads, after), 0.0)
        return model, (leads < 0) & moving, np.clip(1.0 + lacks / own.clip(1e-9), 1.0, 2.0)


def _greatest(values: Array, width: int) -> Array:
    """The greatest of each `width` values (n,) that follow each other: (n - width + 1,)."""
    return np.asarray(np.lib.stride_tricks.sliding_window_view(values, width).max(axis=-1))


def _paired(rows: Iterator[Parameters]) -> Iterator[Command]:
    """T3 for each row, but TD for two that are the halves of a ramp."""
    held: Parameters | None = None
    for row in rows:
        if held is not None:
            t, rate1, _, jerk1, rate2, _, jerk2 = held
            if row[0] == t and row[3] == -jerk1 and row[6] == -jerk2:
                yield TD(t, rate1, row[1], row[2], jerk1, rate2, row[4], row[5], jerk2)
                held = None
                continue
            yield T3(*held)
            held = None
        if not row[2] and not row[5] and (row[3] or row[6]):
            held = row
        else:
            yield T3(*row)
    if held is not None:
        yield T3(*held)


class Stepwise(Family):
    """Base of the families that approximate: spans of samples, slowed down while they are too far off."""

    name = ""
    order = 1

    def motion(self, borders: Borders, last: bool = True) -> Iterator[Command | Mark]:
        tolerance = self.tolerance_steps * ONE_STEP
        factor, slower = 1.0, self.slower(borders, 1.0)
        for _ in range(8):
            samples = self.samples(slower)
            least = self.sustainable_ticks(self.name, slower)
            spans = cut(samples, self.order, tolerance, least, LONGEST_TICKS, one_way=True)
            if spans.worst <= tolerance * self.sizing.worst_steps:
                break
            # An error of a line goes with T^2 a, a of a motion with 1 / factor^2; of a parabola with the cube.
            excess = spans.worst / (tolerance * self.sizing.worst_steps)
            factor *= max(1.05, excess ** (1 / (self.order + 1)))
            slower = self.slower(borders, factor)
        if factor > 1:
            yield self.slowing(borders, slower)
        self.begun = None if last else slowness(borders, slower)
        yield from self.commands(samples, spans.cuts.tolist() if last else without_short_end(samples, spans, least), last)

    def slower(self, borders: Borders, factor: float) -> Borders:
        """The motion `factor` times as slow, or, where it goes on from a part that was not, soon so."""
        if self.begun in (None, factor):
            return stretched(borders, factor) if factor > 1 else borders
        return slowed(borders, np.full(len(borders), factor), rises(borders), self.begun)[0]

    @property
    def tolerance_steps(self) -> float:
        return self.sizing.sm_steps if self.order == 1 else self.sizing.lt_steps

    @abstractmethod
    def samples(self, borders: Borders) -> Samples:
        """The motion sampled where spans may begin and end."""

    @abstractmethod
    def commands(self, samples: Samples, cuts: list[int], last: bool) -> Iterator[Command]:
        """A command for each span; the motion's last ends on its rounded end for certain if it is the `last` part of it."""

    def done(self, command: Command) -> Command:
        """Note what the board will have after the command."""
        self.state = self.executed(command).state
        return command

    def executed(self, command: Command) -> Executed:
        """What the board will do by the command when it comes next."""
        execute = arithmetic_old.execute if self.firmware.old_arithmetic else arithmetic.execute
        return execute(command, self.state)


class Quadratic(Stepwise):
    """LT, or LM where `counting`."""

    order = 2

    def __init__(self, firmware: Firmware, kinematics: Kinematics, sizing: Sizing, counting: bool) -> None:
        super().__init__(firmware, kinematics, sizing)
        self.counting = counting
        self.name = "LM" if counting else "LT"

    def samples(self, borders: Borders) -> Samples:
        return sampled(borders, 3 * TICKS_PER_MS, turns=True)

    def commands(self, samples: Samples, cuts: list[int], last: bool) -> Iterator[Command]:
        ticks, x, v = samples.ticks[cuts].tolist(), samples.x[cuts], samples.v[cuts]
        for i in range(len(cuts) - 1):
            lasts, final = ticks[i + 1] - ticks[i], last and i == len(cuts) - 2
            old = self.firmware.old_arithmetic
            one, two = (
                encode_quadratic.axis_piece(
                    self.state.position[k],
                    self.state.acc[k],
                    lasts,
                    x[i, k],
                    x[i + 1, k],
                    v[i + 1, k] - v[i, k],
                    old=old,
                    final=final,
                )
                for k in (0, 1)
            )
            if self.counting:
                command = encode_quadratic.counted(lasts, one, two)
            else:
                command = encode_quadratic.timed(lasts, one, two, old)
            if command is not None:
                yield self.done(command)


class Linear(Stepwise):
    """SM, or XM where `mixed`: motor 1 takes a + b, motor 2 a - b."""

    changes_speed = False

    def __init__(self, firmware: Firmware, kinematics: Kinematics, sizing: Sizing, mixed: bool) -> None:
        super().__init__(firmware, kinematics, sizing)
        self.mixed = mixed
        self.name = "XM" if mixed else "SM"

    def samples(self, borders: Borders) -> Samples:
        return on_milliseconds(borders, TICKS_PER_MS)

    def commands(self, samples: Samples, cuts: list[int], last: bool) -> Iterator[Command]:
        times_ms = (samples.ticks[cuts] // TICKS_PER_MS).tolist()
        targets = np.rint(samples.x[cuts] / ONE_STEP).astype(np.int64).tolist()
        for i, (one, two) in enumerate(targets[1:]):
            duration_ms, final = times_ms[i + 1] - times_ms[i], last and i == len(targets) - 2
            n1, n2 = one - self.state.position[0], two - self.state.position[1]
            command = self._move(duration_ms, n1, n2, final)
            fewest = min(abs(n1), abs(n2))
            if not final and 0 < fewest <= _FEW_STEPS and self._waited_steps(command) > _WAITED_STEPS:
                # The next move has them.
                command = self._move(duration_ms, 0 if abs(n1) == fewest else n1, 0 if abs(n2) == fewest else n2, final)
            yield self.done(command)

    def _move(self, duration_ms: int, n1: int, n2: int, final: bool) -> MotionCommand:
        if self.mixed and not ((n1 + n2) % 2 and final):
            return XM(duration_ms, (n1 + n2) // 2, (n1 - n2) // 2)
        return SM(duration_ms, n1, n2)

    def _waited_steps(self, command: MotionCommand) -> float:
        """How many steps the faster motor could have taken while it waits for the other's last, whose rate is cut off."""
        moves = self.executed(command).segments
        rates = [abs(profile.r0) for profile in moves[0].profile]
        waits = moves[-1].profile[int(np.argmax(rates))] == STILL
        return max(rates) * moves[-1].ticks / ONE_STEP if waits else 0.0


def choose(name: str, firmware: Firmware, kinematics: Kinematics, sizing: Sizing) -> Family:
    """The family that `name` says, `auto` for the firmware's best. Raises BadCommand when the firmware lacks it."""
    needs = {"t3": "T3", "lt": "LT", "lm": "LM", "sm": "SM", "xm": "XM"}
    if name == "auto":
        name = next(family for family in ("t3", "lt", "sm") if needs[family] in firmware.motion)
    if name not in needs:
        raise BadCommand(f"there are no commands {name!r}; choose auto, {', '.join(needs)}")
    if needs[name] not in firmware.motion:
        has = ", ".join(family for family in needs if needs[family] in firmware.motion)
        raise BadCommand(f"firmware {firmware.name} has no {needs[name]}; choose one of {has}, or auto")
    if name == "t3":
        return Cubic(firmware, kinematics, sizing, pairs="TD" in firmware.motion)
    if name in ("lt", "lm"):
        return Quadratic(firmware, kinematics, sizing, counting=name == "lm")
    return Linear(firmware, kinematics, sizing, mixed=name == "xm")
