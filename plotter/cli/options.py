"""Command-line options made from the settings' schema, so that a flag, its help and its bounds are said once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

import click
from pydantic.fields import FieldInfo

from plotter.cli.help import HeadedOption, Heading
from plotter.settings import ResolvedSettings, Settings, resolve

Command = TypeVar("Command", bound=Callable[..., Any])

# The port that stands for the built-in virtual board.
SIM = "sim"
_METAVARS = {
    "speed": "SPEED",
    "acceleration": "ACCEL",
    "jerk": "JERK",
    "time": "TIME",
    "dwell": "TIME",
    "lead": "TIME",
    "tolerance": "LENGTH",
    "join": "LENGTH",
    "margin": "LENGTH",
    "x": "LENGTH",
    "y": "LENGTH",
    "up": "PERCENT",
    "down": "PERCENT",
    "low": "PERCENT",
    "low_lift": "LENGTH",
    "overlap": "SHARE",
    "lift": "NAME",
    "stroke": "LENGTH",
    "overdraw": "LENGTH",
    "dip": "TIME",
    "every": "AMOUNT",
    "well": "X,Y",
}
# Where each setting stands in the help, those that people reach for first before the others.
_HEADINGS: dict[Heading, tuple[str, ...]] = {
    Heading.MACHINE: ("machine", "quality", "firmware"),
    Heading.PAGE: ("fit", "margin", "scale", "rotate", "offset_x", "offset_y"),
    Heading.SPEED: ("draw_speed", "travel_speed", "tolerance", "constant_speed"),
    Heading.PEN: ("pen_up", "pen_down", "lift", "low_lift", "overlap"),
    Heading.INK: ("reink_every", "well", "dip"),
    Heading.ORDER: ("order", "group", "reverse", "interleave", "start", "end"),
    Heading.FINER_SPEED: ("draw_acceleration", "draw_jerk", "travel_acceleration", "travel_jerk"),
    Heading.FINER_PEN: ("pen_low", "lift_time", "lower_time", "dot_dwell"),
    Heading.FINER_ORDER: ("join", "keep_duplicates", "seams", "overdraw", "max_stroke", "order_time", "seed"),
    Heading.BOARD: ("lead", "commands", "checksums"),
}


def settings_options(command: Command) -> Command:
    """Give `command` a flag for every setting, and `--settings FILE`. `collect` turns them back into settings."""
    for heading, names in reversed(_HEADINGS.items()):
        for name in reversed(names):
            command = _option(name, Settings.model_fields[name], heading)(command)
    return click.option(
        "--settings",
        "settings_file",
        cls=HeadedOption,
        heading=Heading.MACHINE,
        type=click.Path(path_type=Path, dir_okay=False),
        help="Settings file (TOML) instead of your own.",
    )(command)


def collect(options: dict[str, Any]) -> ResolvedSettings:
    """Settings from a command's options, which loses them: what is left belongs to the command. Raises BadInput."""
    file = options.pop("settings_file", None)
    given = {name: options.pop(name, None) for name in Settings.model_fields}
    return resolve({name: value for name, value in given.items() if value is not None}, file)


def _option(name: str, field: FieldInfo, heading: Heading) -> Callable[[Command], Command]:
    flag, text = "--" + name.replace("_", "-"), field.description or ""
    kind: dict[str, Any]
    if field.annotation is bool:
        kind = {"is_flag": True, "default": None}
    elif get_origin(field.annotation) is Literal:
        kind = {"type": click.Choice(get_args(field.annotation))}
    else:
        kind = {"metavar": _METAVARS.get(name) or _METAVARS.get(name.rsplit("_", 1)[-1], name.upper())}
    return click.option(flag, name, cls=HeadedOption, heading=heading, help=text, **kind)
