"""What watches over a plot: the limit switch (CU,51 to 53) and the motors' supply (CU,60)."""

from __future__ import annotations

from dataclasses import dataclass

ADC_SCAN_TICKS = 150  # V+ is compared with its threshold about every 6 ms
SUPPLY_ADC = 300


@dataclass(slots=True)
class LimitSwitch:
    """`port_b` are the pins at the moment of the last stop; `reply_due` while the host has not been told."""

    mask: int = 0
    target: int = 0
    replies: bool = False
    triggered: bool = False
    port_b: int = 0
    reply_due: bool = False

    def closed(self, port_b: int) -> bool:
        """Whether any masked pin equals its target bit."""
        return bool(~(port_b ^ self.target) & self.mask)

    def clear(self) -> None:
        """Moves are taken again; a switch that is still closed stops them again."""
        self.triggered = False
        self.reply_due = False


@dataclass(slots=True)
class Supply:
    """The barrel jack. `lost` latches when a scan finds V+ under the threshold."""

    on: bool = True
    threshold: int = 0
    lost: bool = False
    scanned_to: int = 0

    @property
    def adc(self) -> int:
        return SUPPLY_ADC if self.on else 0

    def scan(self, tick: int) -> None:
        """Take into account the scans since the last call; called before anything changes and before the flag is read."""
        if tick // ADC_SCAN_TICKS > self.scanned_to // ADC_SCAN_TICKS and self.adc < self.threshold:
            self.lost = True
        self.scanned_to = tick

    def forget(self, tick: int) -> None:
        """Back to the settings of boot; whether the jack is powered stays."""
        self.threshold = 0
        self.lost = False
        self.scanned_to = tick
