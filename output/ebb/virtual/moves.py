"""What waits in the motion queue, as the parser leaves it there."""

from __future__ import annotations

from dataclasses import dataclass

from output.ebb.virtual.registers import Ramp


@dataclass(frozen=True, slots=True)
class StepperMove:
    """A move of both axes. Ends after `ticks`, or (ticks None) when each axis has taken its `steps`.

    `ramps` are signed rates (LM, L3, LT, T3, TD), or with `signs` magnitudes with a fixed direction (SM, XM, HM, TR and
    firmware 2.x). `clear` holds, for each axis, the value its accumulator is given at the load, or None to keep it.
    `dead_ticks` pass after a timed move before the next entry is loaded.
    """

    command: str
    ramps: tuple[Ramp, Ramp]
    clear: tuple[int | None, int | None]
    ticks: int | None = None
    steps: tuple[int, int] = (0, 0)
    signs: tuple[int, int] = (1, 1)
    dead_ticks: int = 0
    about_ticks: int = 0


@dataclass(frozen=True, slots=True)
class Delay:
    """Nothing for `ticks`."""

    command: str
    ticks: int


@dataclass(slots=True)
class PenMove:
    """Send the servo on RP`rp_pin` to `target` (83.3 ns units) at `rate` a frame; the queue waits `ticks`.

    SP,3 rewrites `target` of what waits.
    """

    command: str
    ticks: int
    target: int
    rate: int
    rp_pin: int


@dataclass(frozen=True, slots=True)
class EnableMotors:
    """EM as executed: None leaves the motor as it is."""

    command: str
    motor1: int
    motor2: int | None
    ticks: int = 1


@dataclass(frozen=True, slots=True)
class Engrave:
    """SE through the queue."""

    command: str
    state: int
    power: int
    ticks: int = 1


QueueEntry = StepperMove | Delay | PenMove | EnableMotors | Engrave
