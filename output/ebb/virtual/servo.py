"""The pen's servo: where it is sent and where it is. Heights in the board's units of 83.3 ns; low numbers are up or down alike.

The real output steps by `rate` once a frame (8 channels of 3 ms); here it moves linearly at that rate.
"""

from __future__ import annotations

from dataclasses import dataclass

from output.ebb.virtual.registers import TICKS_PER_S

UP_AT_BOOT = 22565
DOWN_AT_BOOT = 15302
RATE_AT_BOOT = 400
POWER_TIMEOUT_MS = 60_000
PEN_RP_PIN = 4


@dataclass(slots=True)
class Servo:
    """`minimum` is the pen-up position and `maximum` the pen-down position, as SC,4 and SC,5 name them."""

    minimum: int = UP_AT_BOOT
    maximum: int = DOWN_AT_BOOT
    rate_up: int = RATE_AT_BOOT
    rate_down: int = RATE_AT_BOOT
    channels: int = 8
    slot_ms: int = 3
    power_timeout_ms: int = POWER_TIMEOUT_MS
    powered: bool = False
    power_off_at: int | None = None
    up: bool = True
    start_position: float = UP_AT_BOOT
    start_tick: int = 0
    target: int = UP_AT_BOOT
    rate: int = 0
    touch: float = (UP_AT_BOOT + DOWN_AT_BOOT) / 2
    touch_side: int = -1
    touch_share: float = 0.5
    rp_pin: int = PEN_RP_PIN

    def frame_ticks(self) -> int:
        return self.channels * self.slot_ms * TICKS_PER_S // 1000

    def position(self, tick: int) -> float:
        """Where the servo is at `tick`."""
        end = self.travel_end()
        if tick >= end:
            return float(self.target)
        share = (tick - self.start_tick) / (end - self.start_tick)
        return self.start_position + (self.target - self.start_position) * share

    def travel_end(self) -> int:
        """The tick at which the servo is where it was sent; a rate of 0 gets there at once."""
        if self.rate <= 0:
            return self.start_tick
        frames = abs(self.target - self.start_position) / self.rate
        return self.start_tick + round(frames * self.frame_ticks())

    def send(self, target: int, rate: int, tick: int) -> None:
        """Start moving to `target`; the state becomes up when that is the pen-up position."""
        self.start_position = self.position(tick)
        self.start_tick = tick
        self.target = target
        self.rate = rate
        self.up = target == self.minimum
        self.power(tick)

    @property
    def lowered(self) -> bool:
        """Sent nearer to pen down than to pen up: S2 may send it anywhere between, which is not `up` as QP has it."""
        return not self.up and abs(self.target - self.maximum) <= abs(self.target - self.minimum)

    def power(self, tick: int) -> None:
        """Power the servo and start its countdown."""
        self.powered = True
        self.power_off_at = tick + self.power_timeout_ms * TICKS_PER_S // 1000 if self.power_timeout_ms else None

    def unpower(self, tick: int) -> None:
        """Without power the servo stays where it is."""
        self.start_position = self.position(tick)
        self.target = round(self.start_position)
        self.start_tick = tick
        self.rate = 0
        self.powered = False
        self.power_off_at = None

    def heights_changed(self) -> None:
        """The pen touches the paper at `touch_share` of the way from down to up, until the two are made equal (SP,3)."""
        if self.minimum != self.maximum:
            self.touch = self.maximum + (self.minimum - self.maximum) * self.touch_share
            self.touch_side = 1 if self.maximum > self.minimum else -1

    def touches(self, position: float) -> bool:
        """Whether the pen is on the paper at that servo position."""
        return (position - self.touch) * self.touch_side >= 0

    def touch_change(self) -> int | None:
        """The tick of the present travel at which the pen comes to touch or leaves the paper, or None."""
        if self.touches(self.start_position) == self.touches(self.target):
            return None
        end = self.travel_end()
        share = (self.touch - self.start_position) / (self.target - self.start_position)
        return self.start_tick + round((end - self.start_tick) * share)
