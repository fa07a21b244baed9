"""The board's tools at the command line, against the virtual board."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from click.testing import CliRunner, Result

from output.ebb.commands import EM, LT
from output.ebb.ports import FoundPort
from output.ebb.progress import Progress
from output.ebb.safe_stop import StopReport
from output.ebb.session import Board, StreamResult, connect
from output.ebb.virtual.process import VirtualBoard, start_virtual_board
from output.errors import BadCommand, BoardRefused, LinkLost
from plotter.cli import board as tools
from plotter.cli.main import cli
from plotter.errors import BadInput, Interrupted
from plotter.settings import resolve

FIRMWARE = ["3.0.3", "2.8.1", "2.7.0"]


@pytest.fixture(params=FIRMWARE)
def virtual(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path: object) -> Iterator[VirtualBoard]:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    with start_virtual_board(firmware=request.param, nickname="East EBB") as board:
        yield board


def call(virtual: VirtualBoard, name: str, *arguments: str, answer: str | None = None) -> Result:
    return CliRunner().invoke(cli, [name, *arguments, "--port", virtual.port], input=answer)


def done(result: Result) -> str:
    assert result.exit_code == 0, (result.output, result.exception)
    return result.output


def test_a_board_tells_everything_it_can(virtual: VirtualBoard) -> None:
    facts = json.loads(done(call(virtual, "board", "--json")))
    version = virtual.state()["firmware"]
    assert facts["firmware"] == version
    assert facts["nickname"] == "East EBB"
    assert facts["queue_max"] == (32 if version.startswith("3") else 1)
    assert facts["supply_v"] == pytest.approx(8.8, abs=0.1)
    assert facts["position_steps"] == [0, 0]
    text = done(call(virtual, "board"))
    assert "firmware           " + version in text
    assert virtual.record()["stepper_moves"] == 0


def test_the_pen_goes_where_it_is_told(virtual: VirtualBoard) -> None:
    assert "down" in done(call(virtual, "pen", "down"))
    assert not virtual.state()["pen_up"]
    assert virtual.state()["pen_touches"]
    assert "up" in done(call(virtual, "pen", "toggle"))
    assert virtual.state()["pen_up"]
    assert "down" in done(call(virtual, "pen", "toggle"))
    assert "up" in done(call(virtual, "pen", "up"))
    assert not virtual.state()["pen_touches"]


def test_the_carriage_moves_exactly_and_comes_home(virtual: VirtualBoard) -> None:
    """AxiDraw: motor 1 = 80 (x + y), motor 2 = 80 (x - y) steps per mm."""
    done(call(virtual, "pen", "down"))
    assert "30.00, 12.50 mm" in done(call(virtual, "move", "3cm", "12.5mm"))
    assert virtual.state()["pen_up"], "a carriage does not travel with the pen down"
    assert virtual.state()["position"] == [3400, 1400]
    done(call(virtual, "move", "-1.01mm", "0"))
    assert virtual.state()["position"] == [3319, 1319]
    done(call(virtual, "move", "--to", "5mm", "5mm"))
    assert virtual.state()["position"] == [800, 0]
    done(call(virtual, "home"))
    assert virtual.state()["position"] == [0, 0]
    assert virtual.state()["motors_on"] == [True, True]
    record = virtual.record()
    assert all(len(stroke["points"]) == 1 for stroke in record["ink"]), "nothing was drawn on the way"
    assert record["parser_blocked"] == []


def test_letting_go(virtual: VirtualBoard) -> None:
    for tool in ("align", "disable"):
        done(call(virtual, "move", "5mm", "5mm"))
        done(call(virtual, tool))
        state = virtual.state()
        assert state["motors_on"] == [False, False]
        assert state["pen_up"]
        assert state["idle"]


def test_outside_the_machine_nothing_moves(virtual: VirtualBoard) -> None:
    for arguments in (["400mm", "0"], ["0", "-1mm"], ["--to", "-0.1mm", "5"]):
        error = call(virtual, "move", *arguments).exception
        assert isinstance(error, BadInput)
        assert "300 x 218 mm" in str(error)
    assert isinstance(call(virtual, "move", "far", "1mm").exception, BadInput)
    assert virtual.record()["stepper_moves"] == 0


def test_a_position_that_was_lost_is_not_used() -> None:
    with start_virtual_board() as virtual:
        done(call(virtual, "move", "20mm", "20mm"))
        with connect(virtual.port) as board:
            board.safe_stop(free_motors=True)
        for arguments in (["home"], ["move", "1mm", "1mm"]):
            error = call(virtual, *arguments).exception
            assert isinstance(error, BoardRefused)
            assert "plotter align" in str(error)
        done(call(virtual, "align"))
        done(call(virtual, "move", "1mm", "1mm"))


def test_a_position_whose_motors_had_no_power_for_a_while_is_not_used() -> None:
    with start_virtual_board() as virtual:
        done(call(virtual, "move", "10mm", "5mm"))
        virtual.control("power off")
        time.sleep(0.1)
        virtual.control("power on")
        for _ in range(2):
            result = call(virtual, "home")
            assert isinstance(result.exception, BoardRefused)
            assert "power failed" in str(result.exception)
            assert "plotter align" in str(result.exception)
        done(call(virtual, "align"))
        assert "at 5.00, " in done(call(virtual, "move", "5mm", "0mm"))


def test_without_motor_power_nothing_pretends_to_move() -> None:
    with start_virtual_board() as virtual:
        virtual.control("power off")
        error = call(virtual, "move", "20mm", "20mm").exception
        assert isinstance(error, BoardRefused)
        assert "no power" in str(error)
        assert virtual.record()["stepper_moves"] == 0


def test_a_nickname_is_written_only_when_confirmed(virtual: VirtualBoard) -> None:
    assert "nothing was changed" in done(call(virtual, "board", "--name", "West", answer="n\n"))
    assert virtual.state()["nickname"] == "East EBB"
    done(call(virtual, "board", "--name", "West", answer="y\n"))
    assert virtual.state()["nickname"] == "West"
    done(call(virtual, "board", "--name", "", "--yes"))
    assert virtual.state()["nickname"] == ""
    for name in ("a,b", "x" * 17, "it's"):
        assert isinstance(call(virtual, "board", "--name", name, "--yes").exception, BadCommand)


def test_ports_are_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tools, "find_ports", lambda: [FoundPort("/dev/ttyACM0", "East EBB", "EiBotBoard")])
    assert CliRunner().invoke(cli, ["ports"]).output == "/dev/ttyACM0\tEast EBB\n"
    listed = json.loads(CliRunner().invoke(cli, ["ports", "--json"]).output)
    assert listed == [{"port": "/dev/ttyACM0", "nickname": "East EBB", "description": "EiBotBoard"}]
    assert "ID_MM_DEVICE_IGNORE" in CliRunner().invoke(cli, ["ports", "--udev"]).output
    monkeypatch.setattr(tools, "find_ports", list)
    result = CliRunner().invoke(cli, ["ports"])
    assert result.exit_code == 0
    assert "no EiBotBoard is plugged in" in result.output


def test_without_a_board_every_tool_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("output.ebb.ports.find_ports", list)
    for name, arguments in (("board", []), ("pen", ["up"]), ("home", []), ("align", []), ("disable", []), ("move", ["1", "1"])):
        error = CliRunner().invoke(cli, [name, *arguments]).exception
        assert isinstance(error, LinkLost), name
        assert "no EiBotBoard is plugged in" in str(error)


def test_a_name_that_is_too_long_is_refused_before_anything_is_asked() -> None:
    with start_virtual_board() as virtual:
        refused = call(virtual, "board", "--name", "x" * 20, answer="")
        assert isinstance(refused.exception, BadCommand)
        assert "at most 16" in str(refused.exception)
        assert "Write the nickname" not in refused.output


def left_moving(virtual: VirtualBoard) -> None:
    """As a program that is killed leaves it: one move being made, one queued."""
    with connect(virtual.port) as board:
        board.send(EM(1, 1))
        for _ in range(2):
            board.send(LT(15000, 480 * 2**31 // 15000, 0, 400 * 2**31 // 15000, 0))  # 0.6 s


def test_home_is_reached_from_wherever_a_move_that_is_still_being_made_ends(virtual: VirtualBoard) -> None:
    left_moving(virtual)
    assert "home" in done(call(virtual, "home"))
    assert virtual.state()["position"] == [0, 0]
    left_moving(virtual)
    done(call(virtual, "move", "--to", "5mm", "5mm"))
    assert virtual.state()["position"] == [800, 0]


def test_here_is_where_the_move_ends_that_is_still_being_made(virtual: VirtualBoard, tmp_path: Path) -> None:
    drawing = tmp_path / "x.svg"
    drawing.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="99mm" height="99mm"><path d="M90 90h20" stroke="red"/></svg>'
    )
    left_moving(virtual)
    done(call(virtual, "plot", str(drawing), "--start", "here"))
    ink = [stroke["points"] for stroke in virtual.record()["ink"] if len(stroke["points"]) > 1]
    (line,) = ink
    assert sorted((line[0], line[-1])) == [[3810, 0], [4233, 423]]


@pytest.mark.parametrize(("pen_up", "said"), [(True, "the motors are off"), (False, "run `plotter align`")])
def test_what_is_said_of_a_stop_on_the_way_is_what_the_board_has_confirmed(pen_up: bool, said: str) -> None:
    stop = StopReport(pen_up, None, 0.1, "")
    result = StreamResult("stopped", "stopped by Ctrl-C", Progress(), None, stop)
    one = cast(Board, SimpleNamespace(stream=lambda *_, **__: result))
    with pytest.raises(Interrupted) as told:
        tools.carriage_to(one, resolve({}).values, np.zeros(2), np.ones(2))
    assert str(told.value).endswith(said)
    assert ("motors are off" in str(told.value)) == pen_up
