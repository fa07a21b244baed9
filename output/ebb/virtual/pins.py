"""The processor's pins as far as commands can see them: directions, output latches and what is wired to the inputs."""

from __future__ import annotations

from dataclasses import dataclass, field

# At boot: B0 pulled up (button), B1 servo pulses, B2 pulled up, B3 low (engraver), B4 low (pen output), B5 to B7 pulled up.
_DIRECTION = {"A": 0x2F, "B": 0b11100101, "C": 0xFF, "D": 0xFF, "E": 0x07}
WIRED = {"A": 0x01, "B": 0xFF, "C": 0x00, "D": 0x00, "E": 0x00}


@dataclass(slots=True)
class Pins:
    """`direction` has a 1 for each input, `latch` what outputs drive, `wired` what inputs see from outside."""

    direction: dict[str, int] = field(default_factory=lambda: dict(_DIRECTION))
    latch: dict[str, int] = field(default_factory=lambda: dict.fromkeys("ABCDE", 0))
    wired: dict[str, int] = field(default_factory=lambda: dict(WIRED))

    def read(self, port: str) -> int:
        """The port as PORTx reads it: outside levels on inputs, the latch on outputs."""
        inputs = self.direction[port]
        return (self.wired[port] & inputs) | (self.latch[port] & ~inputs & 0xFF)

    def reset(self) -> None:
        """Directions and latches as at boot; what is wired stays wired."""
        self.direction = dict(_DIRECTION)
        self.latch = dict.fromkeys("ABCDE", 0)

    @staticmethod
    def with_bit(value: int, pin: int, on: bool) -> int:
        return value | 1 << pin if on else value & ~(1 << pin)
