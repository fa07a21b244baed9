"""Machine and pen-lift profiles: TOML files beside this module, read through one schema with its bounds."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from planning.motion.clearance import Clearance
from planning.motion.limits import Kinematics
from plotter.errors import BadInput

Positive = Field(gt=0, allow_inf_nan=False)


class _Profile(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class PenLift(_Profile):
    """A pen lift as the board drives it: pulse lengths in 83.3 ns units, moved by `rate` every `period_ms`.

    `lag_ms` is how far the tip may be behind the pulse, `percent_ms` what the servo takes for one percent at its full speed.
    Shares of the way from pen down (0) to pen up (1): the paper lies between `touch_low` and `touch_high`, and a low lift goes
    to `low`. `channels` is how many servo outputs of 3 ms share a period. `output` is what the board switches: its servo output
    on RB`pin`, or the solenoid output RB4.
    """

    title: str
    output: Literal["servo", "solenoid"] = "servo"
    pin: int = Field(ge=0, le=7)
    channels: int = Field(8, ge=1, le=8)
    pulse_at_0: int = Field(ge=1, le=65535)
    pulse_at_100: int = Field(ge=1, le=65535)
    up_percent: float = Field(ge=0, le=100)
    down_percent: float = Field(ge=0, le=100)
    period_ms: float = Positive
    rate_up: int = Field(ge=1, le=65535)
    rate_down: int = Field(ge=1, le=65535)
    settle_up_ms: float = Field(ge=0, le=5000)
    settle_down_ms: float = Field(ge=0, le=5000)
    lag_ms: float = Field(ge=0, le=5000)
    percent_ms: float = Field(ge=0, le=1000)
    touch_low: float = Field(ge=0, le=1)
    touch_high: float = Field(ge=0, le=1)
    low: float = Field(gt=0, le=1)

    @property
    def other_pin(self) -> int | None:
        """The servo's RB pin as SP names it; None for the board's own, RB1."""
        return None if self.pin == 1 else self.pin

    def pulse(self, percent: float) -> int:
        """The pulse length for a height in percent."""
        return round(self.pulse_at_0 + (self.pulse_at_100 - self.pulse_at_0) * percent / 100)

    @property
    def up_pulse(self) -> int:
        return self.pulse(self.up_percent)

    @property
    def down_pulse(self) -> int:
        return self.pulse(self.down_percent)

    def lift_s(self) -> float:
        """From the command to the pen being up: whole servo periods for the way, one more for the phase, and settling.

        Never less than until the tip is clear of the paper, wherever that is.
        """
        return max(self._way_s(self.rate_up) + self.settle_up_ms / 1000, self._tip_s(self.rate_up, self.touch_high))

    def lower_s(self) -> float:
        """From the command to the pen being on the paper and quiet."""
        settle_s = self.settle_down_ms / 1000
        return settle_s + max(self._way_s(self.rate_down), self._tip_s(self.rate_down, 1 - self.touch_low))

    def clearance(self, lift_s: float, lower_s: float, low: float) -> Clearance:
        """How high the pen certainly is, where lifting and lowering are given `lift_s` and `lower_s` instead of the profile's

        own times: a lift that is said to be slower is slower all the way, but may still fall as fast. `low` is the height of a
        low lift.
        """
        up, down = (given / own if own > 0 else 1.0 for given, own in ((lift_s, self.lift_s()), (lower_s, self.lower_s())))
        return Clearance(
            rise_s=self._even_ms(self.rate_up) / 1000 * up,
            fall_s=self._even_ms(self.rate_down) / 1000 * down,
            drop_s=self._even_ms(self.rate_down) / 1000 * min(1.0, down),
            late_s=(self.period_ms + self.lag_ms) / 1000 * max(1.0, up, down),
            settle_s=self.settle_down_ms / 1000 * max(1.0, down),
            touch_low=self.touch_low,
            touch_high=self.touch_high,
            low=low,
            # Each period begins with a whole step, which the servo makes at its full speed, and then waits for the next.
            early_s=max(self.period_ms - self._servo_ms(self.rate_down), 0.0) / 1000,
        )

    def _tip_s(self, rate: int, share: float) -> float:
        """Until the tip has certainly gone this share of the way, in whole milliseconds."""
        return math.ceil(self.period_ms + self.lag_ms + share * self._even_ms(rate)) / 1000

    def _even_ms(self, rate: int) -> float:
        """The whole way, by steps of `rate` or at the servo's full speed, whichever takes longer."""
        way = abs(self.up_pulse - self.down_pulse)
        return max(way * self.period_ms / rate, self._servo_ms(way))

    def _servo_ms(self, pulse: float) -> float:
        """How long the servo takes for so much pulse at its full speed."""
        return pulse * self.percent_ms * 100 / abs(self.pulse_at_100 - self.pulse_at_0)

    def _way_s(self, rate: int) -> float:
        periods = math.ceil(abs(self.up_pulse - self.down_pulse) / rate) + 1
        return periods * self.period_ms / 1000


class Machine(_Profile):
    """A plotter: how far it reaches, how millimetres become motor steps, and its pen lift."""

    name: str
    title: str
    board: Literal["ebb"]
    width_mm: float = Positive
    height_mm: float = Positive
    steps_per_mm: tuple[tuple[float, float], tuple[float, float]]
    max_step_rate: float = Field(gt=0, le=25000)
    pen_lift: str

    def kinematics(self) -> Kinematics:
        return Kinematics(np.array(self.steps_per_mm), self.max_step_rate)


class QualityLimits(_Profile):
    """What a quality stands for: the XY motion's bounds, pen down and (per motor) pen up."""

    draw_speed_mm_s: float = Positive
    draw_acceleration_mm_s2: float = Positive
    draw_jerk_mm_s3: float = Positive
    travel_speed_mm_s: float = Positive
    travel_acceleration_mm_s2: float = Positive
    travel_jerk_mm_s3: float = Positive
    tolerance_mm: float = Field(ge=0.005, le=0.2)
    lead_s: float = Field(ge=0.15, le=1.2)


def machine_names() -> list[str]:
    """The machines that come with the program, by name."""
    files = resources.files("plotter.machines").iterdir()
    names = (file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml"))
    return sorted(name for name in names if name != "qualities")


def load_machine(name: str) -> Machine:
    """The machine profile called `name`, or the one in the file `name` when that ends in .toml.

    Raises BadInput naming the profiles there are when there is none of that name, or what is wrong with the file.
    """
    if name.endswith(".toml"):
        return _machine_file(Path(machine_key(name)))
    if name not in machine_names():
        names = ", ".join(machine_names())
        raise BadInput(
            f"there is no machine '{name}': choose one of {names} (see `plotter machines`), or give your own FILE.toml"
        )
    return Machine.model_validate({"name": name, **_toml(f"{name}.toml")})


def machine_key(name: str) -> str:
    """What to remember of a chosen machine: its name, or where its file is, whatever the folder one is in later."""
    return str(Path(name).expanduser().absolute()) if name.endswith(".toml") else name


def _machine_file(path: Path) -> Machine:
    try:
        machine = Machine.model_validate({"name": str(path), **tomllib.loads(path.read_text(encoding="utf-8"))})
        machine.kinematics()
    except OSError as error:
        raise BadInput(f"cannot read the machine profile {path}: {error.strerror}; check the path") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadInput(f"the machine profile {path} is not TOML: {error}") from None
    except ValidationError as error:
        raise BadInput(f"the machine profile {path}: {first_fault(error)}; docs/machines.md shows one") from None
    except ValueError as error:
        raise BadInput(f"the machine profile {path}: {error}; docs/machines.md shows one") from None
    load_pen_lift(machine.pen_lift)
    return machine


def pen_lift_names() -> list[str]:
    """The pen lifts that come with the program, by name."""
    files = (resources.files("plotter.machines") / "pen_lifts").iterdir()
    return sorted(file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml"))


def load_pen_lift(name: str) -> PenLift:
    """The pen-lift profile called `name`. Raises BadInput, naming the ones there are, when there is none."""
    if name not in pen_lift_names():
        raise BadInput(f"there is no pen lift '{name}': choose one of {', '.join(pen_lift_names())}")
    return PenLift.model_validate(_toml(f"pen_lifts/{name}.toml"))


def load_quality(name: str) -> QualityLimits:
    """The limits of quality `name`. Raises BadInput when there is none of that name."""
    qualities = _toml("qualities.toml")
    if name not in qualities:
        raise BadInput(f"there is no quality '{name}': choose one of {', '.join(qualities)}")
    return QualityLimits.model_validate(qualities[name])


def _toml(name: str) -> dict[str, object]:
    return tomllib.loads((resources.files("plotter.machines") / name).read_text(encoding="utf-8"))


_BOUNDS = {"ge": "at least", "gt": "more than", "le": "at most", "lt": "less than"}


def _as_in_a_file(key: str, value: object) -> str:
    return f"{key} = {value!r}"


def first_fault(
    error: ValidationError,
    written: Callable[[str, object], str] = _as_in_a_file,
    unit: Callable[[str], str] = lambda _key: "",
) -> str:
    """A pydantic refusal in one clause: which key, what was given, and what it must be.

    `written` says how key and value were given, `unit` what bounds of a key are in.
    """
    fault = error.errors()[0]
    key = ".".join(str(part) for part in fault["loc"]) or "settings"
    if fault["type"] == "extra_forbidden":
        return f"there is no setting '{key}'"
    if fault["type"] == "missing":
        return f"{key} is missing"
    context = fault.get("ctx", {})
    bounds = (f"must be {words} {context[name]:g} {unit(key)}".rstrip() for name, words in _BOUNDS.items() if name in context)
    bound = next(bounds, None)
    reason = fault["msg"].removeprefix("Value error, ")
    return f"{written(key, fault['input'])} {bound or 'is refused: ' + reason}" if fault["loc"] else reason
