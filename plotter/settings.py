"""Settings: one schema for flags and settings files, with its bounds, and where each value came from.

A value is taken from the flag, else from the settings file, else from what the quality, the machine or its pen lift says.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
import platformdirs
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from output.ebb.firmware import firmware
from output.errors import BadCommand
from planning.motion.clearance import PenTiming
from planning.motion.limits import Limits
from planning.motion.reinking import Reinking
from plotter import units
from plotter.errors import BadInput
from plotter.machines.profile import Machine, PenLift, first_fault, load_machine, load_pen_lift, load_quality, machine_key


@dataclass(frozen=True, slots=True)
class Unit:
    """What a bare number is in, and so are the bounds."""

    name: str


def _written(parse: Callable[[str], float]) -> BeforeValidator:
    return BeforeValidator(lambda value: parse(value) if isinstance(value, str) else value)


Length = Annotated[float, _written(units.length_mm), Unit("mm")]
Speed = Annotated[float, _written(units.speed_mm_s), Unit("mm/s"), Field(gt=0, le=1000, allow_inf_nan=False)]
Acceleration = Annotated[float, _written(units.acceleration_mm_s2), Unit("mm/s2"), Field(gt=0, le=100_000, allow_inf_nan=False)]
Jerk = Annotated[float, _written(units.jerk_mm_s3), Unit("mm/s3"), Field(gt=0, le=100_000_000, allow_inf_nan=False)]
Delay = Annotated[float, _written(units.time_s), Unit("s"), Field(ge=0, le=60, allow_inf_nan=False)]
Percent = Annotated[float, _written(units.percent), Unit("%"), Field(ge=0, le=100, allow_inf_nan=False)]
Budget = Annotated[float, _written(units.time_s), Unit("s"), Field(ge=0, le=3600, allow_inf_nan=False)]

# The longest that may be said between two re-inkings, in millimetres or seconds.
LONGEST_REINK = 1_000_000.0


class Settings(BaseModel):
    """Everything that can be set. The field's description is the flag's help; its bounds are where the value is read."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    machine: str = Field("axidraw-v3", description="Machine profile (see `plotter machines`).")
    quality: Literal["draft", "normal", "fine"] = Field("normal", description="Set of speeds and tolerance to start from.")
    firmware: str = Field("3.0.3", description="Board firmware to plan and export for; a connected board says its own.")

    draw_speed: Speed = Field(description="Greatest speed pen down.")
    draw_acceleration: Acceleration = Field(description="Greatest acceleration pen down.")
    draw_jerk: Jerk = Field(description="Greatest jerk pen down.")
    travel_speed: Speed = Field(description="Greatest speed of each motor pen up.")
    travel_acceleration: Acceleration = Field(description="Greatest acceleration of each motor pen up.")
    travel_jerk: Jerk = Field(description="Greatest jerk of each motor pen up.")
    tolerance: Annotated[Length, Field(ge=0.005, le=0.2)] = Field(description="How far the pen may leave its path.")
    constant_speed: bool = Field(False, description="As even a speed on paper as the limits allow.")

    lift: str | None = Field(
        None, description="Pen lift: standard-servo, brushless or solenoid; the machine's own when not given."
    )
    pen_up: Percent = Field(description="Pen height when up.")
    pen_down: Percent = Field(description="Pen height when down.")
    pen_low: Percent | None = Field(None, description="Pen height of a low lift.")
    low_lift: Annotated[Length, Field(ge=0, le=1000)] = Field(
        5.0, description="Lift only to the low height for travels shorter than this; 0 is never."
    )
    lift_time: Delay = Field(description="Time to wait for the pen to rise.")
    lower_time: Delay = Field(description="Time to wait for the pen to reach the paper.")
    overlap: Annotated[float, Field(ge=0, le=1)] = Field(
        0.8, description="How much of the pen's way lies within travel, 0 (none of it) to 1 (all that keeps it off the paper)."
    )
    dot_dwell: Delay = Field(0.05, description="How long the pen rests on a dot.")

    order: Literal["none", "greedy", "best", "random"] = Field("best", description="How strokes are put in order.")
    order_time: Budget = Field(10.0, description="Time that `best` may take.")
    join: Annotated[Length, Field(ge=0, le=10)] = Field(0.1, description="Stroke ends closer than this become one stroke.")
    keep_duplicates: bool = Field(False, description="Draw lines that lie on each other as often as the file has them.")
    seams: Literal["hidden", "same", "random", "free"] = Field(
        "hidden",
        description="Where closed strokes start: at a sharp corner, as in the file, anywhere, or where travel is shortest.",
    )
    overdraw: Annotated[Length, Field(ge=0, le=50)] = Field(0.0, description="How far closed strokes go on beyond their start.")
    reverse: bool = Field(False, description="Draw layers and colours last to first.")
    interleave: bool = Field(
        False, description="Draw every other stroke on the way out, the rest on the way back, to let ink dry."
    )
    max_stroke: Annotated[Length, Field(gt=0)] | None = Field(None, description="Cut strokes longer than this.")
    reink_every: str | None = Field(
        None,
        description="Re-ink the pen after so much ink (2m) or time (5min): in the well, or in a pause without one.",
    )
    well: str | None = Field(None, description="Where the pen is dipped to re-ink it: X,Y from home.")
    dip: Delay = Field(0.5, description="How long the pen stays down in the well.")
    group: Literal["layer", "number", "color"] = Field(
        "layer", description="Layers as in the file, by the number that their name begins with, or one for each colour."
    )
    lead: Annotated[Delay, Field(ge=0.15, le=1.2)] = Field(
        description="Motion that the board's queue is never short of; what is too dense for that is slowed down."
    )
    commands: Literal["auto", "t3", "lt", "lm", "sm", "xm"] = Field("auto", description="Board commands to use.")
    checksums: bool = Field(False, description="Have the board check every command it gets (firmware 3).")
    seed: int = Field(0, ge=0, description="Seed of the ordering's random choices.")

    rotate: Literal["auto", "0", "90", "180", "270"] = Field(
        "auto", description="Turn the page clockwise; auto turns it by 90 when it only fits so."
    )
    fit: bool = Field(False, description="Scale the drawing to fill the machine's travel within the margin.")
    scale: float = Field(1.0, gt=0, le=1000, description="Scale the drawing by this factor.")
    margin: Annotated[Length, Field(ge=0, le=500)] = Field(10.0, description="Margin that --fit leaves.")
    offset_x: Annotated[Length, Field(ge=-5000, le=5000)] = Field(0.0, description="Move the drawing right.")
    offset_y: Annotated[Length, Field(ge=-5000, le=5000)] = Field(0.0, description="Move the drawing down.")
    start: Literal["home", "here"] = Field(
        "home", description="Where the pen is: at home, or where the board counts it to be (its motors still on)."
    )
    end: Literal["home", "stay", "top-left", "top-right", "bottom-left", "bottom-right"] = Field(
        "home", description="Where the pen goes when all is drawn; away from home the motors hold."
    )

    @model_validator(mode="after")
    def _up_is_above_down(self) -> Settings:
        if self.pen_up <= self.pen_down:
            raise ValueError(f"--pen-up ({self.pen_up:g} %) must be above --pen-down ({self.pen_down:g} %)")
        if self.pen_low is not None and not self.pen_down < self.pen_low <= self.pen_up:
            bounds = f"above --pen-down ({self.pen_down:g} %) and at most at --pen-up ({self.pen_up:g} %)"
            raise ValueError(f"--pen-low ({self.pen_low:g} %) must lie {bounds}")
        return self

    @field_validator("machine")
    @classmethod
    def _machine_is_found_again(cls, name: str) -> str:
        return machine_key(name)

    @field_validator("firmware")
    @classmethod
    def _firmware_is_known(cls, version: str) -> str:
        try:
            return firmware(version).name
        except BadCommand as error:
            raise ValueError(str(error)) from None

    @field_validator("reink_every", "well")
    @classmethod
    def _can_be_read(cls, value: str | None, field: ValidationInfo) -> str | None:
        if value is not None and field.field_name == "well":
            units.point_mm(value)
        elif value is not None and not 0 < sum(amount or 0.0 for amount in units.amount(value)) <= LONGEST_REINK:
            raise ValueError(f"it must be more than nothing and at most {LONGEST_REINK / 1000:g} m or {LONGEST_REINK:g} s")
        return value

    @model_validator(mode="after")
    def _a_well_has_its_times(self) -> Settings:
        if self.well is not None and self.reink_every is None:
            raise ValueError(f"--well ({self.well}) needs --reink-every, to say how often the pen goes there")
        return self

    def reinking(self) -> Reinking | None:
        """When the pen is re-inked and where; None is never."""
        if self.reink_every is None:
            return None
        every_mm, every_s = units.amount(self.reink_every)
        well_mm = None if self.well is None else np.array(units.point_mm(self.well))
        return Reinking(every_mm or math.inf, every_s or math.inf, well_mm, self.dip)

    @property
    def longest_stroke_mm(self) -> float | None:
        """Longer strokes are cut: by hand, or so that the pen is re-inked in time. None: none is cut.

        What is drawn in a time is known only when it is planned; at full speed a piece takes half of it at most.
        """
        longest = [] if self.max_stroke is None else [self.max_stroke]
        if self.reink_every is not None:
            every_mm, every_s = units.amount(self.reink_every)
            longest.append(every_mm or (every_s or math.inf) * self.draw_speed / 2)
        return min(longest, default=None)

    def machine_profile(self) -> Machine:
        return load_machine(self.machine)

    @property
    def ends_at_home(self) -> bool:
        return self.end in ("home", "top-left")

    def end_mm(self) -> np.ndarray | None:
        """Where the pen goes when all is drawn (2,), in machine millimetres; None is nowhere."""
        machine = self.machine_profile()
        right, low = machine.width_mm * self.end.endswith("right"), machine.height_mm * self.end.startswith("bottom")
        return None if self.end == "stay" else np.array([right, low])

    def draw_limits(self) -> Limits:
        return Limits(self.draw_speed, self.draw_acceleration, self.draw_jerk, self.tolerance)

    def travel_limits(self) -> Limits:
        return Limits(self.travel_speed, self.travel_acceleration, self.travel_jerk, self.tolerance)

    def pen_lift(self) -> PenLift:
        """The machine's pen lift with this pen's heights."""
        profile = load_pen_lift(self.lift or self.machine_profile().pen_lift)
        return profile.model_copy(update={"up_percent": self.pen_up, "down_percent": self.pen_down})

    @property
    def low_percent(self) -> float:
        """The height of a low lift; when none is given, the pen lift's share of this pen's way."""
        if self.pen_low is not None:
            return self.pen_low
        return self.pen_down + self.pen_lift().low * (self.pen_up - self.pen_down)

    def pen_timing(self) -> PenTiming:
        """How long the plan waits for the pen, and what of that overlaps with travel."""
        low = (self.low_percent - self.pen_down) / (self.pen_up - self.pen_down)
        clearance = self.pen_lift().clearance(self.lift_time, self.lower_time, low)
        return PenTiming(self.lower_time, self.lift_time, self.dot_dwell, self.overlap, self.low_lift, clearance)


@dataclass(frozen=True, slots=True)
class ResolvedSettings:
    """The settings in force, and for each key a few words on where its value came from."""

    values: Settings
    origin: Mapping[str, str]


def settings_path() -> Path:
    """Where the settings file is looked for when none is named."""
    return platformdirs.user_config_path("plotter") / "settings.toml"


# Profiles carry units in their keys; a setting's value may be written with one.
_UNIT = re.compile(r"(_mm)?(_s[23]?)?$")


def resolve(flags: Mapping[str, Any], file: Path | None = None) -> ResolvedSettings:
    """Flags over the settings file over profiles. `flags` holds only what was given; `file` None means the user's own, if any.

    Raises BadInput naming the key, the value and its bound; an unknown key is an error.
    """
    from_file = _read_file(file)
    given = {**from_file, **flags}
    origin = {key: "flag" if key in flags else f"settings file {file or settings_path()}" for key in given}
    machine = load_machine(str(given.get("machine", Settings.model_fields["machine"].default)))
    quality_name = str(given.get("quality", Settings.model_fields["quality"].default))
    quality = load_quality(quality_name).model_dump()
    lift_name = str(given.get("lift") or machine.pen_lift)
    lift = load_pen_lift(lift_name)
    for key, value in quality.items():
        name = _UNIT.sub("", key)
        if name not in given:
            given[name], origin[name] = value, f"quality {quality_name}"
    for name, height in (("pen_up", lift.up_percent), ("pen_down", lift.down_percent)):
        if name not in given:
            given[name], origin[name] = height, f"pen lift {lift_name}"
    given.setdefault("lift_time", 0.0)
    given.setdefault("lower_time", 0.0)
    values = _validated(given, origin)
    if "dip" in flags and values.well is None:
        wanting = "--well" if values.reink_every is not None else "--reink-every and --well"
        raise BadInput(f"--dip {flags['dip']} is for re-inking: give {wanting} with it")
    lift = values.pen_lift()
    timed = {}
    for name, value in (("lift_time", lift.lift_s()), ("lower_time", lift.lower_s()), ("pen_low", values.low_percent)):
        if name not in origin:
            timed[name], origin[name] = value, f"pen lift {lift_name}"
    values = values.model_copy(update=timed)
    return ResolvedSettings(values, {name: origin.get(name, "default") for name in Settings.model_fields})


def _validated(given: Mapping[str, Any], origin: Mapping[str, str]) -> Settings:
    try:
        return Settings.model_validate(given)
    except ValidationError as error:
        fault = first_fault(error, lambda key, value: _as_given(key, value, origin), _unit)
        raise BadInput(f"{fault}; see `plotter settings --help-all` for what it may be") from None


def _as_given(key: str, value: object, origin: Mapping[str, str]) -> str:
    """A setting as its flag, or as its file has it."""
    where = origin.get(key, "flag")
    return f"--{key.replace('_', '-')} {value}" if where == "flag" else f"{where}: {key} = {value!r}"


def _unit(key: str) -> str:
    """The unit that a setting's bounds are in; nothing for one that has none."""
    field = Settings.model_fields[key]
    marks = [*field.metadata, *(mark for kind in get_args(field.annotation) for mark in get_args(kind)[1:])]
    return next((mark.name for mark in marks if isinstance(mark, Unit)), "")


def _read_file(file: Path | None) -> dict[str, Any]:
    path = file or settings_path()
    if file is None and not path.exists():
        return {}
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadInput(f"cannot read the settings file {path}: {error.strerror}; give another with --settings") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadInput(f"the settings file {path} is not TOML: {error}") from None
