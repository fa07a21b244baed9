"""Firmware generations: what a board with a given version knows, and what it can sustain. The data is in `firmware.toml`."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any

from output.ebb.commands import CU, EM, ES, HM, LM, LT, QL, QU, SC, SL, SM, SP, XM, Command, Version
from output.errors import BadCommand

NEWEST: Version = (3, 0, 3)
_VERSION = re.compile(r"(\d{1,3})\.(\d{1,3})(?:\.(\d{1,3}))?$")


@dataclass(frozen=True, slots=True)
class Firmware:
    """One version of the firmware. Durations in milliseconds, depths in commands, rates in steps per second.

    `motion` are the names of its motion commands, best first. `service_ms` maps a command's name ("other" for the rest) to how
    long the board needs to take it in: idle, and with both motors at 25 kHz. `least_ms` is the shortest duration of a command
    that can be streamed for ever without gaps. `old_arithmetic` is True for 1.x and 2.x.
    """

    version: Version
    generation: str
    motion: tuple[str, ...]
    queue_default: int
    queue_max: int
    dead_ticks: int
    least_steps_per_s: float
    max_sm_ms: int
    max_sm_steps: int
    max_delay_ms: int
    service_ms: Mapping[str, tuple[float, float]]
    least_ms: Mapping[str, float]
    old_arithmetic: bool

    @property
    def name(self) -> str:
        return ".".join(str(part) for part in self.version)

    def has(self, command: Command) -> bool:
        """Whether this version knows the command at all."""
        return command.since <= self.version and (command.until is None or self.version < command.until)

    def queues(self, command: Command) -> bool:
        """Whether the command waits in the motion queue: EM only since 2.8.0."""
        if isinstance(command, EM):
            return self.version >= (2, 8, 0)
        return command.queued

    def refusal(self, command: Command) -> str | None:
        """Why this version would refuse the command or read it differently, or None."""
        if not self.has(command):
            until = "" if command.until is None else f" and before {'.'.join(map(str, command.until))}"
            return (
                f"{command.name} needs firmware {'.'.join(map(str, command.since))} or newer{until}, the board has {self.name}"
            )
        newer = self._newer_form(command)
        if newer is not None:
            form, since = newer
            return f"{form} needs firmware {'.'.join(map(str, since))} or newer, the board has {self.name}; leave it out"
        return self._out_of_range(command)

    def _newer_form(self, command: Command) -> tuple[str, Version] | None:
        """A form of the command that this version does not know, and the first that does."""
        forms: list[tuple[bool, str, Version]] = []
        match command:
            case SP(value=value):
                forms = [(value > 1, f"SP,{value}", (3, 0, 1))]
            case SL(index=index):
                forms = [(index is not None, "SL with an index", (3, 0, 0))]
            case QL(index=index):
                forms = [(index is not None, "QL with an index", (3, 0, 0))]
            case ES(disable_motors=disable):
                forms = [(disable is not None, "ES with a parameter", (2, 8, 0))]
            case SM(clear=clear) | XM(clear=clear):
                forms = [(clear is not None, f"Clear for {command.name}", (3, 0, 0))]
            case CU(number=number):
                forms = [(number > 3, f"CU,{number}", (3, 0, 0)), (number == 3, "CU,3", (2, 8, 1))]
            case QU(number=number):
                forms = [(number == 6, "QU,6", (3, 0, 1))]
        return next(((text, since) for used, text, since in forms if used and self.version < since), None)

    def _out_of_range(self, command: Command) -> str | None:
        """A value that this version would refuse or take for another."""
        limits: list[tuple[str, int, int]] = []
        match command:
            case EM(enable2=None) if self.version >= (2, 8, 0):
                return f"EM needs both parameters on firmware {self.name}; give motor 2's as well"
            case SC(number=8, value=value) if self.version >= (3, 0, 0):
                limits = [("servo channels of SC,8", value, 8)]
            case SM(duration_ms=ms, steps1=one, steps2=two):
                limits = self._sm_limits(ms, one, two or 0)
            case XM(duration_ms=ms, steps_a=one, steps_b=two):
                limits = self._sm_limits(ms, one + two, one - two)
            case LM(rate1=one, rate2=two) if self.old_arithmetic and min(one, two) < 0:
                return f"LM: a rate is {min(one, two)}, allowed is 0 or more on firmware {self.name}; give the steps the sign"
            case LT(rate1=0, rate2=0) if self.old_arithmetic:
                return f"LT: both rates are 0, which firmware {self.name} refuses; use SM for a delay"
            case HM(position1=one, position2=two) if self.old_arithmetic:
                limits = [("position of HM", abs(one or 0), 4_294_967), ("position of HM", abs(two or 0), 4_294_967)]
        for what, value, most in limits:
            if value > most:
                return f"{what} is {value}, allowed is up to {most} on firmware {self.name}; split the command"
        return None

    def _sm_limits(self, duration_ms: int, one: int, two: int) -> list[tuple[str, int, int]]:
        if not one and not two:
            # Firmware 3 shortens a longer delay to 100 s, 2.x counts it modulo 65536 ms.
            return [("delay in ms", duration_ms, self.max_delay_ms)]
        most = self.max_sm_steps
        return [("duration in ms", duration_ms, self.max_sm_ms), ("steps", abs(one), most), ("steps", abs(two), most)]


def parse_version(text: str) -> Version:
    """`2.8.1` or `3.0` as three numbers. Raises BadCommand."""
    match = _VERSION.match(text.strip())
    if match is None:
        raise BadCommand(f"firmware version {text!r} is not like 2.8.1; give the version that `plotter board` prints")
    return (int(match[1]), int(match[2]), int(match[3] or 0))


@lru_cache(maxsize=1)
def _generations() -> list[dict[str, Any]]:
    text = resources.files("output.ebb").joinpath("firmware.toml").read_text(encoding="utf-8")
    rows: list[dict[str, Any]] = tomllib.loads(text)["generation"]
    return rows


def firmware(version: str | Version = NEWEST) -> Firmware:
    """The profile of a version, given as `"3.0.2"` or (3, 0, 2).

    A version that is newer than any known is taken for its generation. Raises BadCommand for one that no table covers.
    """
    number = parse_version(version) if isinstance(version, str) else version
    for row in _generations():
        if tuple(row["since"]) <= number < tuple(row["until"]):
            return Firmware(
                version=number,
                generation=row["name"],
                motion=tuple(row["motion"]),
                queue_default=row["queue_default"],
                queue_max=row["queue_max"],
                dead_ticks=row["dead_ticks"],
                least_steps_per_s=row["least_steps_per_s"],
                max_sm_ms=row["max_sm_ms"],
                max_sm_steps=row["max_sm_steps"],
                max_delay_ms=row["max_delay_ms"],
                service_ms={name: (pair[0], pair[1]) for name, pair in row["service_ms"].items()},
                least_ms=dict(row["least_ms"]),
                old_arithmetic=row["arithmetic"] == "v2",
            )
    raise BadCommand(f"firmware {'.'.join(map(str, number))} is not known (1.0 to 3.x are); update the board or the program")
