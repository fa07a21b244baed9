"""What differs between the firmware versions the virtual board can be."""

from __future__ import annotations

from dataclasses import dataclass

from output.errors import BadCommand


@dataclass(frozen=True, slots=True)
class Firmware:
    """Traits of one version.

    `signed_rates`: the 3.x step interrupt (rates with a sign, jerk, a dead tick after timed moves); otherwise that of 2.7
    and 2.8.1. `one_error`: 3.0.3 reports the first error of a command and nothing more; earlier versions stack them.
    """

    version: str
    number: tuple[int, int, int]
    signed_rates: bool
    one_error: bool
    max_queue: int

    @property
    def version_line(self) -> str:
        return f"EBBv13_and_above EB Firmware Version {self.version}"

    def since(self, major: int, minor: int, patch: int) -> bool:
        return self.number >= (major, minor, patch)


def _make(major: int, minor: int, patch: int) -> Firmware:
    number = (major, minor, patch)
    return Firmware(
        version=f"{major}.{minor}.{patch}",
        number=number,
        signed_rates=major >= 3,
        one_error=number >= (3, 0, 3),
        max_queue=32 if major >= 3 else 1,
    )


FIRMWARES = {fw.version: fw for fw in (_make(*n) for n in ((2, 7, 0), (2, 8, 1), (3, 0, 0), (3, 0, 1), (3, 0, 2), (3, 0, 3)))}


def firmware(version: str) -> Firmware:
    """The traits of `version`. Raises BadCommand for one the virtual board cannot be."""
    try:
        return FIRMWARES[version]
    except KeyError:
        raise BadCommand(f"no virtual board has firmware {version}; choose one of {', '.join(FIRMWARES)}") from None
