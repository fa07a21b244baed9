"""The board's tools: which boards there are, what one says of itself, and moving pen and carriage by hand's order."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, TypeVar

import click
import numpy as np

from output.ebb.commands import EM, SP, Command
from output.ebb.control import StopFlag, signals_end_here
from output.ebb.encode import encode, pen_heights, prologue
from output.ebb.nickname import wrong_nickname
from output.ebb.ports import UDEV_RULE, choose_port, find_ports
from output.ebb.program import Program
from output.ebb.session import Board, connect
from output.errors import BadCommand, PositionLost
from plotter.board_setup import board_setup
from plotter.cli.options import SIM
from plotter.cli.standard_streams import done
from plotter.errors import BadInput, Interrupted
from plotter.settings import Settings, resolve
from plotter.units import length_mm

_Wrapped = TypeVar("_Wrapped", bound=Callable[..., Any])
_PEN_TIMEOUT_S = 70.0

port_option = click.option(
    "--port", help="The board: its port or its nickname; `sim` is a fresh virtual one. Default: the only one there is."
)


def pen_options(command: _Wrapped) -> _Wrapped:
    """The settings that say which machine and pen this is."""
    command = click.option("--pen-down", metavar="PERCENT", help="Pen height when down.")(command)
    command = click.option("--pen-up", metavar="PERCENT", help="Pen height when up.")(command)
    command = click.option("--lift", metavar="NAME", help="Pen lift; the machine's own when not given.")(command)
    return click.option("--machine", metavar="NAME", help="Machine profile (see `plotter machines`).")(command)


def tool_settings(**flags: str | None) -> Settings:
    """The settings in force for a tool: its flags over the settings file. Raises BadInput."""
    return resolve({name: value for name, value in flags.items() if value is not None}).values


@contextmanager
def opened(port: str | None, *, clear: bool, pen_pin: int | None = None) -> Iterator[Board]:
    """The board at `port`; with `clear` whatever still moves is stopped and the pen, on its RB pin, raised first."""
    if port == SIM:
        from output.ebb.virtual.process import start_virtual_board

        with start_virtual_board() as virtual, connect(virtual.port, clear=clear, pen_pin=pen_pin) as board:
            yield board
        return
    with connect(choose_port(port), clear=clear, pen_pin=pen_pin) as board:
        yield board


# looking


@click.command()
@click.option("--json", "as_json", is_flag=True, help="For programs.")
@click.option("--udev", is_flag=True, help="Print the udev rule for Linux that gives you access and keeps modem programs off.")
def ports(as_json: bool, udev: bool) -> None:
    """List the EiBotBoards that are plugged in, with their nicknames.

    \b
    plotter ports
    plotter ports --udev | sudo tee /etc/udev/rules.d/60-eibotboard.rules
    """
    if udev:
        click.echo(UDEV_RULE)
        return
    found = find_ports()
    if as_json:
        click.echo(
            json.dumps([{"port": one.device, "nickname": one.nickname, "description": one.description} for one in found])
        )
        return
    for one in found:
        click.echo(f"{one.device}\t{one.nickname}")
    if not found:
        click.echo("no EiBotBoard is plugged in: check the USB cable and that it carries data", err=True)


@click.command()
@port_option
@click.option("--json", "as_json", is_flag=True, help="For programs.")
@click.option("--name", metavar="NICKNAME", help="Give the board this nickname (at most 16 characters; '' takes it away).")
@click.option("--yes", is_flag=True, help="Do not ask before the nickname is written.")
def board(port: str | None, as_json: bool, name: str | None, yes: bool) -> None:
    """What a board says of itself: firmware, supply, queue, pen, motors, nickname. Nothing moves.

    \b
    plotter board
    plotter board --port "East EBB" --json
    plotter board --name "East EBB"
    """
    with opened(port, clear=False) as one:
        if name is not None:
            _rename(one, name, yes)
            return
        facts = facts_of(one)
    if as_json:
        click.echo(json.dumps(facts))
        return
    for key, value in facts.items():
        text = "unknown" if value is None else ("yes" if value else "no") if isinstance(value, bool) else value
        click.echo(f"{key.replace('_', ' '):<18} {text}")


def facts_of(one: Board) -> dict[str, Any]:
    """Everything that a board can be asked without moving; None for what its firmware cannot tell."""
    deep, version = one.abilities.deep_queue, one.abilities.version
    return {
        "port": one.port_name,
        "firmware": one.firmware,
        "nickname": one.nickname(),
        "supply_v": round(one.supply_v(), 1),
        "queue_depth": int(one.query("QU,3").split(",")[-1]) if deep else 1,
        "queue_max": int(one.query("QU,2").split(",")[-1]) if deep else 1,
        "queue_waiting": int(one.query("QU,6").split(",")[-1]) if one.abilities.counts_queue else None,
        "moving": one.is_moving(),
        "pen_up": one.query("QP") == "1",
        "servo_power": one.query("QR") == "1" if version >= (2, 6, 0) else None,
        "motors_on": not one.motors_off() if version >= (2, 8, 0) else None,
        "position_steps": list(one.steps()),
    }


def _rename(one: Board, name: str, yes: bool) -> None:
    if (wrong := wrong_nickname(name)) is not None:
        raise BadCommand(wrong)
    old = one.nickname() or "no name"
    if not yes and not click.confirm(f"Write the nickname {name!r} into the board at {one.port_name} (now: {old})?", err=True):
        click.echo("nothing was changed", err=True)
        return
    one.set_nickname(name)
    done(f"the board at {one.port_name} is named {name!r}; unplug it and plug it in for the computer to see it")


# the pen


@click.command()
@click.argument("what", type=click.Choice(["up", "down", "toggle"]))
@port_option
@pen_options
def pen(what: str, port: str | None, **flags: str | None) -> None:
    """Raise or lower the pen.

    \b
    plotter pen up
    plotter pen down --pen-down 35%
    """
    settings = tool_settings(**flags)
    with opened(port, clear=False, pen_pin=settings.pen_lift().other_pin) as one:
        up = what == "up" or (what == "toggle" and one.query("QP") == "0")
        for command in _heights(one, settings):
            one.send(command)
        lift = settings.pen_lift()
        wait_ms = round(1000 * (lift.lift_s() if up else lift.lower_s()))
        one.send(SP(1 if up else 0, wait_ms, lift.other_pin), timeout_s=_PEN_TIMEOUT_S)
        one.wait_until_still(_PEN_TIMEOUT_S)
    done(f"the pen is {'up' if up else 'down'}")


def _heights(one: Board, settings: Settings) -> Iterator[Command]:
    """The pen's heights and speeds, as every tool says them before it moves the pen."""
    setup = board_setup(settings, settings.machine_profile(), one.firmware)
    return pen_heights(setup.pen, setup.firmware)


# the carriage


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("x", metavar="X")
@click.argument("y", metavar="Y")
@click.option("--to", "absolute", is_flag=True, help="X and Y are a position from home, not a distance from here.")
@port_option
@pen_options
def move(x: str, y: str, absolute: bool, port: str | None, **flags: str | None) -> None:
    """Move the carriage with the pen up, by X to the right and Y down.

    \b
    plotter move 10mm -5mm
    plotter move --to 2in 2in
    """
    try:
        given = np.array([length_mm(x), length_mm(y)])
    except ValueError as error:
        raise BadInput(f"{error}: give two lengths, as in `plotter move 10mm -5mm`") from None
    settings = tool_settings(**flags)
    with opened(port, clear=True, pen_pin=settings.pen_lift().other_pin) as one:
        start_mm = position_mm(one, settings)
        end_mm = carriage_to(one, settings, start_mm, given if absolute else start_mm + given)
    done(f"the carriage is at {end_mm[0]:.2f}, {end_mm[1]:.2f} mm")


@click.command()
@port_option
@pen_options
def home(port: str | None, **flags: str | None) -> None:
    """Raise the pen and bring the carriage back to where it was when the motors were switched on.

    \b
    plotter home
    """
    settings = tool_settings(**flags)
    with opened(port, clear=True, pen_pin=settings.pen_lift().other_pin) as one:
        carriage_to(one, settings, position_mm(one, settings), np.zeros(2))
    done("the carriage is at home")


@click.command()
@port_option
@pen_options
def align(port: str | None, **flags: str | None) -> None:
    """Raise the pen and let go of the motors, so that the carriage can be pushed to its home corner.

    \b
    plotter align
    """
    _let_go(port, tool_settings(**flags))
    done("the pen is up and the motors are off: push the carriage to its home corner")


@click.command()
@port_option
@pen_options
def disable(port: str | None, **flags: str | None) -> None:
    """Stop whatever moves, raise the pen, and switch the motors off.

    \b
    plotter disable
    """
    _let_go(port, tool_settings(**flags))
    done("everything is stopped, the pen is up and the motors are off")


def _let_go(port: str | None, settings: Settings) -> None:
    with opened(port, clear=True, pen_pin=settings.pen_lift().other_pin) as one:
        for command in _heights(one, settings):
            one.send(command)
        lift = settings.pen_lift()
        one.send(SP(1, round(1000 * lift.lift_s()), lift.other_pin))
        one.wait_until_still(_PEN_TIMEOUT_S)
        one.send(EM(0, 0))
        one.wait_until_still(_PEN_TIMEOUT_S)
        one.begin_job()  # the carriage may be pushed now: a plot that was interrupted must not take the board for its own


def position_mm(one: Board, settings: Settings) -> np.ndarray:
    """Where the carriage is, in machine millimetres from home (2,), by the board's own count, once it stands still: a board
    whose program was killed goes on with what it has, and firmware 2 makes a queued move even after a stop.

    Raises PositionLost when the motors were let go, or their supply has failed, away from home: the count says nothing then;
    BoardRefused when it goes on moving for long.
    """
    one.wait_until_still()
    steps = one.steps()
    if steps != (0, 0):
        off = "the motors were switched off" if one.motors_off() else "the motors' power failed" if one.supply_failed() else ""
        if off:
            raise PositionLost(f"{off} at {steps[0]}, {steps[1]} steps from home, so that the position is not known")
    return np.asarray(settings.machine_profile().kinematics().millimetres(np.array([steps]))[0])


def carriage_to(one: Board, settings: Settings, start_mm: np.ndarray, end_mm: np.ndarray) -> np.ndarray:
    """Moves with the pen up to the step nearest to `end_mm` (2,), smoothly; returns the position reached.

    Raises BadInput outside the machine, Interrupted when it was stopped, and what the board's errors are.
    """
    profile = settings.machine_profile()
    if not (0 <= end_mm[0] <= profile.width_mm and 0 <= end_mm[1] <= profile.height_mm):
        raise BadInput(
            f"{end_mm[0]:.2f}, {end_mm[1]:.2f} mm is outside the machine's travel of {profile.width_mm:g} x "
            f"{profile.height_mm:g} mm: nothing was moved"
        )
    stop = StopFlag()
    with signals_end_here(stop):
        result = one.stream(_travel_program(one, settings, start_mm, end_mm), on_progress=lambda _: None, stop=stop)
    if result.outcome != "done":
        sure = result.stop is not None and result.stop.pen_up
        after = "the pen is up and the motors are off" if sure else "the board has not confirmed that: run `plotter align`"
        raise Interrupted(f"{result.reason}: the carriage was stopped on its way; {after}")
    return position_mm(one, settings)


def _travel_program(one: Board, settings: Settings, start_mm: np.ndarray, end_mm: np.ndarray) -> Program:
    """Pen heights, pen up, and the travel; the step counters go on from where they are."""
    from planning.motion.plan import Travel
    from planning.motion.travel import travel

    profile = settings.machine_profile()
    # Counted from here: the encoder's steps are relative, and the board's counters keep their distance from home.
    setup = board_setup(settings, profile, one.firmware, start_mm)
    setup = replace(setup, pen=replace(setup.pen, first_lift_s=settings.pen_lift().lift_s()))
    reach = ((0.0, 0.0), (profile.width_mm, profile.height_mm))
    yield from prologue(setup, keep_counters=True)
    yield from encode([Travel(travel(start_mm, end_mm, settings.travel_limits(), setup.kinematics, reach))], setup)
