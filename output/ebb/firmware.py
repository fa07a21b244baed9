"""Firmware generations: what a board with a given version knows, and what it can sustain. The data is in `firmware.toml`."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any

from output.ebb.commands import CU, EM, ES, S2, SL, SP, Command, Version
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
        match command:
            case SP(value=2 | 3) if self.version < (3, 0, 1):
                return f"SP,{command.value} needs firmware 3.0.1 or newer, the board has {self.name}"
            case SL(index=int()) if self.version < (3, 0, 0):
                return f"SL with an index needs firmware 3.0.0 or newer, the board has {self.name}"
            case ES(disable_motors=int()) if self.version < (2, 8, 0):
                return f"ES with a parameter needs firmware 2.8.0 or newer, the board has {self.name}"
            case EM(enable2=None) if self.version >= (2, 8, 0):
                return f"EM needs both parameters on firmware {self.name}"
            case CU(number=number) if self.version < (3, 0, 0) and number > 3:
                return f"CU,{number} needs firmware 3.0.0 or newer, the board has {self.name}"
            case CU(number=3) if self.version < (2, 8, 1):
                return f"CU,3 needs firmware 2.8.1 or newer, the board has {self.name}"
            case S2(pin=pin) if pin > 24:
                return f"S2 has no pin {pin}"
        return None


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
