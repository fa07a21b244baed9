"""`plotter virtual`: a virtual EiBotBoard on a pseudo-terminal, for this program or any other."""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path

import click

from output.ebb.virtual.firmware import FIRMWARES
from output.ebb.virtual.process import need_pseudo_terminals
from plotter.cli.outputs import spare
from plotter.cli.ranges import NumberRange


@click.command("virtual")
@click.option("--pty", "link", type=click.Path(path_type=Path), help="Make this path a link to the port, e.g. ./ebb.")
@click.option("--firmware", type=click.Choice(list(FIRMWARES)), default="3.0.3", show_default=True, help="What it runs.")
@click.option("--speed", type=NumberRange(0, 1000, min_open=True), default=1.0, show_default=True, help="Times real time.")
@click.option("--record", type=click.Path(path_type=Path), help="Write what was drawn to this JSON file at the end.")
@click.option("--faults", type=click.Path(path_type=Path), help="JSON file that says what goes wrong, and when.")
@click.option("--nickname", default="", help="The board's name tag.")
@click.option("--pen-down", is_flag=True, help="Start with the pen on the paper.")
@click.option("--patience", type=NumberRange(0, 60), default=0.0, help="Seconds it waits for the host before it runs dry.")
@click.option(
    "--control", is_flag=True, help="Take lines from standard input: button, power off, power on, hangup 2, state, ..."
)
@click.option("--json", "as_json", is_flag=True, help="Print the port as JSON.")
def virtual(
    link: Path | None,
    firmware: str,
    speed: float,
    record: Path | None,
    faults: Path | None,
    nickname: str,
    pen_down: bool,
    patience: float,
    control: bool,
    as_json: bool,
) -> None:
    """Run a virtual EiBotBoard until Ctrl-C.

    It answers like the firmware it is told to be, takes the time a board takes, and keeps a record of the ink. Open the port it
    prints like that of a real board.

    \b
      plotter virtual --pty ./ebb
      plotter virtual --firmware 2.8.1 --speed 10 --record drawn.json
    """
    spare({"fault script": faults}, record)
    need_pseudo_terminals()
    from output.ebb.virtual.server import make_server

    server = make_server(
        firmware=firmware,
        link=link,
        speed=speed,
        record=record,
        faults=faults,
        nickname=nickname,
        pen_down=pen_down,
        patience_s=patience,
        control=sys.stdin.fileno() if control else None,
    )
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: server.stop())
    assert server.wire is not None
    port = server.wire.port
    click.echo(json.dumps({"port": port}) if as_json else f"virtual EiBotBoard, firmware {firmware}, on {port}; Ctrl-C ends it")
    server.run()
    if record is not None and not as_json:
        click.echo(f"what it drew: {record}")
