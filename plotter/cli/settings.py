"""`plotter machines` and `plotter settings`: what can be chosen, and what is in force."""

from __future__ import annotations

import json
from typing import Any

import click

from plotter.cli.help import HeadedCommand
from plotter.cli.options import collect, settings_options
from plotter.machines.profile import load_machine, machine_names


@click.command()
@click.option("--json", "as_json", is_flag=True, help="For programs.")
def machines(as_json: bool) -> None:
    """List the machine profiles."""
    profiles = [load_machine(name) for name in machine_names()]
    if as_json:
        click.echo(json.dumps([profile.model_dump() for profile in profiles], indent=2))
        return
    for profile in profiles:
        click.echo(f"{profile.name:20} {profile.width_mm:g} x {profile.height_mm:g} mm   {profile.title}")


@click.command("settings", cls=HeadedCommand)
@settings_options
@click.option("--json", "as_json", is_flag=True, help="For programs.")
def show_settings(as_json: bool, **options: Any) -> None:
    """Print the settings in force, and where each value came from."""
    resolved = collect(options)
    values = resolved.values.model_dump()
    if as_json:
        click.echo(json.dumps({key: {"value": value, "from": resolved.origin[key]} for key, value in values.items()}, indent=2))
        return
    for key, value in values.items():
        click.echo(f"{key:20} = {_toml(value):12} # {resolved.origin[key]}")


def _toml(value: object) -> str:
    """A value as the settings file writes it."""
    return json.dumps(value)
