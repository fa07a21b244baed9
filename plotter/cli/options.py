"""Command-line options made from the settings' schema, so that a flag, its help and its bounds are said once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

import click
from pydantic.fields import FieldInfo

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


def settings_options(command: Command) -> Command:
    """Give `command` a flag for every setting, and `--settings FILE`. `collect` turns them back into settings."""
    for name, field in reversed(Settings.model_fields.items()):
        command = _option(name, field)(command)
    path = click.Path(path_type=Path, dir_okay=False)
    return click.option("--settings", "settings_file", type=path, help="Settings file (TOML) instead of your own.")(command)


def collect(options: dict[str, Any]) -> ResolvedSettings:
    """Settings from a command's options, which loses them: what is left belongs to the command. Raises BadInput."""
    file = options.pop("settings_file", None)
    given = {name: options.pop(name, None) for name in Settings.model_fields}
    return resolve({name: value for name, value in given.items() if value is not None}, file)


def _option(name: str, field: FieldInfo) -> Callable[[Command], Command]:
    flag, text = "--" + name.replace("_", "-"), field.description or ""
    if field.annotation is bool:
        return click.option(flag, name, is_flag=True, default=None, help=text)
    if get_origin(field.annotation) is Literal:
        return click.option(flag, name, type=click.Choice(get_args(field.annotation)), help=text)
    metavar = _METAVARS.get(name) or _METAVARS.get(name.rsplit("_", 1)[-1], name.upper())
    return click.option(flag, name, metavar=metavar, help=text)
