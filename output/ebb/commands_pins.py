"""The commands of the EBB that a plot does not need: pins, analog inputs, memory, counters, the nickname. See `commands`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from output.ebb.commands import FLAG, I32, U8, U16, U32, Bound, Command, Version
from output.errors import BadCommand

PIN: Bound = (0, 7)
PORTS = "ABCDE"
RAM: Bound = (0, 4095)


def _printable(command: Command, parameter: str, value: str, length: int) -> None:
    if len(value) > length or not all(" " <= letter <= "~" and letter != "," for letter in value):
        raise BadCommand(
            f"{command.name}: {parameter} is {value!r}, allowed are at most {length} printable ASCII characters, no comma; "
            "change the text"
        )


@dataclass(frozen=True, slots=True)
class A(Command):
    """Values of the analog inputs that AC enabled."""

    name: ClassVar[str] = "A"
    since: ClassVar[Version] = (2, 2, 3)


@dataclass(frozen=True, slots=True)
class AC(Command):
    """Enable or disable an analog input."""

    name: ClassVar[str] = "AC"
    bounds: ClassVar[tuple[Bound, ...]] = ((0, 15), FLAG)
    since: ClassVar[Version] = (2, 2, 3)
    channel: int
    enable: int


@dataclass(frozen=True, slots=True)
class BL(Command):
    """Leave for the bootloader. No reply."""

    name: ClassVar[str] = "BL"
    since: ClassVar[Version] = (1, 9, 5)


@dataclass(frozen=True, slots=True)
class C(Command):
    """Pin directions of all ports: the TRIS registers."""

    name: ClassVar[str] = "C"
    bounds: ClassVar[tuple[Bound, ...]] = (U8, U8, U8, U8, U8)
    port_a: int
    port_b: int
    port_c: int
    port_d: int
    port_e: int


@dataclass(frozen=True, slots=True)
class CK(Command):
    """Check the parameter parser: one of each kind, printed back."""

    name: ClassVar[str] = "CK"
    numbers: ClassVar[tuple[Bound, ...]] = (U8, (-128, 127), U16, (-32768, 32767), U32, I32)
    u8: int
    i8: int
    u16: int
    i16: int
    u32: int
    i32: int
    character: str
    upper: str

    def __post_init__(self) -> None:
        for name, (low, high) in zip(("u8", "i8", "u16", "i16", "u32", "i32"), self.numbers, strict=True):
            value = getattr(self, name)
            if type(value) is not int or not low <= value <= high:
                self.refuse(name, value, f"{low} to {high}")
        _printable(self, "character", self.character, 1)
        _printable(self, "upper", self.upper, 1)


@dataclass(frozen=True, slots=True)
class CN(Command):
    """Clear the node counter: only ever in 1.9.3 and 1.9.4."""

    name: ClassVar[str] = "CN"
    since: ClassVar[Version] = (1, 9, 3)
    until: ClassVar[Version | None] = (1, 9, 5)


@dataclass(frozen=True, slots=True)
class I(Command):  # noqa: E742 - the board's own name
    """All ports, read as digital inputs."""

    name: ClassVar[str] = "I"


@dataclass(frozen=True, slots=True)
class MR(Command):
    """Read a byte of RAM."""

    name: ClassVar[str] = "MR"
    bounds: ClassVar[tuple[Bound, ...]] = (RAM,)
    address: int


@dataclass(frozen=True, slots=True)
class MW(Command):
    """Write a byte of RAM."""

    name: ClassVar[str] = "MW"
    bounds: ClassVar[tuple[Bound, ...]] = (RAM, U8)
    address: int
    data: int


@dataclass(frozen=True, slots=True)
class ND(Command):
    """Node counter down by one."""

    name: ClassVar[str] = "ND"
    since: ClassVar[Version] = (1, 9, 5)


@dataclass(frozen=True, slots=True)
class NI(Command):
    """Node counter up by one."""

    name: ClassVar[str] = "NI"
    since: ClassVar[Version] = (1, 9, 5)


@dataclass(frozen=True, slots=True)
class O(Command):  # noqa: E742 - the board's own name
    """Write the ports' output latches, as many as are given."""

    name: ClassVar[str] = "O"
    bounds: ClassVar[tuple[Bound, ...]] = (U8, U8, U8, U8, U8)
    port_a: int
    port_b: int | None = None
    port_c: int | None = None
    port_d: int | None = None
    port_e: int | None = None


@dataclass(frozen=True, slots=True)
class PC(Command):
    """Pulse lengths and periods in ms on RB0 to RB3, for PG. Gone in 3.0."""

    name: ClassVar[str] = "PC"
    bounds: ClassVar[tuple[Bound, ...]] = (U16,) * 8
    until: ClassVar[Version | None] = (3, 0, 0)
    length0_ms: int
    period0_ms: int
    length1_ms: int | None = None
    period1_ms: int | None = None
    length2_ms: int | None = None
    period2_ms: int | None = None
    length3_ms: int | None = None
    period3_ms: int | None = None

    def check(self) -> None:
        for pin in range(4):
            length, period = getattr(self, f"length{pin}_ms"), getattr(self, f"period{pin}_ms")
            if length is not None and (period is None or period < length):
                self.refuse(f"period{pin}_ms", period, f"{length} (the length) to 65535")


@dataclass(frozen=True, slots=True)
class PG(Command):
    """Pulses of PC on or off. Gone in 3.0."""

    name: ClassVar[str] = "PG"
    bounds: ClassVar[tuple[Bound, ...]] = (FLAG,)
    until: ClassVar[Version | None] = (3, 0, 0)
    on: int


@dataclass(frozen=True, slots=True)
class PinCommand(Command):
    """Base of the commands that name one pin: a port letter A to E and a pin 0 to 7."""

    port: str
    pin: int

    def __post_init__(self) -> None:
        if self.port not in PORTS or len(self.port) != 1:
            self.refuse("port", repr(self.port), "one of A, B, C, D, E")
        if type(self.pin) is not int or not 0 <= self.pin <= 7:
            self.refuse("pin", self.pin, "0 to 7")
        self.check()


@dataclass(frozen=True, slots=True)
class PD(PinCommand):
    """Direction of a pin: 0 output, 1 input."""

    name: ClassVar[str] = "PD"
    direction: int

    def check(self) -> None:
        if self.direction not in (0, 1):
            self.refuse("direction", self.direction, "0 to 1")


@dataclass(frozen=True, slots=True)
class PI(PinCommand):
    """Read a pin."""

    name: ClassVar[str] = "PI"


@dataclass(frozen=True, slots=True)
class PO(PinCommand):
    """Write a pin."""

    name: ClassVar[str] = "PO"
    value: int

    def check(self) -> None:
        if self.value not in (0, 1):
            self.refuse("value", self.value, "0 to 1")


@dataclass(frozen=True, slots=True)
class QN(Command):
    """Node counter."""

    name: ClassVar[str] = "QN"
    since: ClassVar[Version] = (1, 9, 2)


@dataclass(frozen=True, slots=True)
class SN(Command):
    """Set the node counter."""

    name: ClassVar[str] = "SN"
    bounds: ClassVar[tuple[Bound, ...]] = (U32,)
    since: ClassVar[Version] = (1, 9, 5)
    value: int


@dataclass(frozen=True, slots=True)
class ST(Command):
    """Set the nickname, kept in flash: at most 16 characters."""

    name: ClassVar[str] = "ST"
    since: ClassVar[Version] = (2, 5, 4)
    tag: str = ""

    def __post_init__(self) -> None:
        _printable(self, "tag", self.tag, 16)

    def wire(self) -> str:
        return f"ST,{self.tag}"


@dataclass(frozen=True, slots=True)
class T(Command):
    """Report digital (mode 0) or analog (1) inputs every `period_ms`; 0 stops. Gone in 3.0."""

    name: ClassVar[str] = "T"
    bounds: ClassVar[tuple[Bound, ...]] = (U16, FLAG)
    until: ClassVar[Version | None] = (3, 0, 0)
    period_ms: int
    mode: int


@dataclass(frozen=True, slots=True)
class OldS2(Command):
    """S2 before 2.2.0, with a channel number first: `S2,0` turns all servos off."""

    name: ClassVar[str] = "S2"
    bounds: ClassVar[tuple[Bound, ...]] = ((0, 7), U16, (0, 24), U16)
    since: ClassVar[Version] = (2, 1, 0)
    until: ClassVar[Version | None] = (2, 2, 0)
    channel: int
    position: int | None = None
    pin: int | None = None
    rate: int | None = None
