"""Where the pen begins and where it goes when all is drawn, on a board that counts; and the orders that people ask for."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from output.ebb.session import connect
from output.ebb.verify_compare import compare
from output.ebb.virtual.process import VirtualBoard, start_virtual_board
from planning.motion.plan import Draw, LayerStart
from plotter.cli.main import run
from plotter.cli.plot import ink_mm
from plotter.machines.profile import load_machine
from plotter.pipeline import planned, prepare
from plotter.settings import resolve
from plotter.svg.options import ReadOptions

MACHINE = load_machine("axidraw-v3")
DRAWING = """<svg xmlns="http://www.w3.org/2000/svg" width="100mm" height="60mm" viewBox="0 0 100 60" stroke="black">
  <path d="M10 10H14"/><path d="M60 30H64"/><path d="M90 50H94"/></svg>"""
LAYERS = """<svg xmlns="http://www.w3.org/2000/svg" xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape" width="60mm"
  height="40mm" viewBox="0 0 60 40" fill="none" stroke="black">
  <g inkscape:groupmode="layer" inkscape:label="notes"><path d="M1 1h5"/></g>
  <g inkscape:groupmode="layer" inkscape:label="10 last"><path d="M1 2h5" stroke="red"/></g>
  <g inkscape:groupmode="layer" inkscape:label="! 2 first"><path d="M1 3h5"/><path d="M1 5h5" stroke="red"/></g></svg>"""


def place_mm(board: VirtualBoard) -> np.ndarray:
    return MACHINE.kinematics().millimetres(np.array([board.state()["position"]], dtype=float))[0]


def test_from_here_the_counters_go_on(drawing: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The pen was moved away: the order begins there, the ink is where it belongs, and home is still home."""
    wanted = [np.array([[x, y], [x + 4.0, y]]) for x, y in ((10.0, 10.0), (60.0, 30.0), (90.0, 50.0))]
    with start_virtual_board() as board:
        assert run(["move", "--to", "95mm", "52mm", "--port", board.port]) == 0
        there = ["--start", "here", "--end", "stay", "--port", board.port]
        assert run(["plot", str(drawing), *there]) == 0, capsys.readouterr().err
        ink = ink_mm(board.record(), MACHINE.kinematics())
        assert np.allclose(ink[0][[0, -1]], [[94, 50], [90, 50]], atol=0.02)
        assert compare(ink, wanted).drawn.max_mm < 0.03
        assert compare(ink, wanted).wanted.max_mm < 0.03
        assert np.allclose(place_mm(board), ink[-1][-1], atol=0.02)
        # The motors hold, so that the next plot can begin here, and goes home.
        assert all(board.state()["motors_on"])
        assert run(["plot", str(drawing), "--start", "here", "--port", board.port]) == 0
        again = ink_mm(board.record(), MACHINE.kinematics())[3:]
        assert compare(again, wanted).drawn.max_mm < 0.03
        assert np.allclose(again[0][[0, -1]], [[10, 10], [14, 10]], atol=0.02)
        assert not any(board.state()["motors_on"])


def test_where_nobody_knows_where_the_pen_is_it_does_not_begin(drawing: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with start_virtual_board() as board:
        assert run(["move", "--to", "95mm", "52mm", "--port", board.port]) == 0
        with connect(str(board.port)) as one:
            one.query("ES,1")  # lets go of the motors
        assert run(["plot", str(drawing), "--start", "here", "--port", board.port]) == 3
        assert "position is not known" in capsys.readouterr().err


def test_only_a_board_knows_where_here_is(drawing: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["export", str(drawing), "-o", str(tmp_path / "x.ebb"), "--start", "here"]) == 2
    assert "only a connected board" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("end", "expected"),
    [
        ("home", (0.0, 0.0)),
        ("top-left", (0.0, 0.0)),
        ("top-right", (300.0, 0.0)),
        ("bottom-left", (0.0, 218.0)),
        ("bottom-right", (300.0, 218.0)),
    ],
)
def test_the_pen_ends_where_it_was_asked_to(end: str, expected: tuple[float, float], drawing: Path, capsys: Any) -> None:
    with start_virtual_board() as board:
        assert run(["plot", str(drawing), "--end", end, "--port", board.port]) == 0, capsys.readouterr().err
        assert np.allclose(place_mm(board), expected, atol=0.02)


def test_the_order_knows_where_the_pen_will_end(drawing: Path) -> None:
    """Three dashes in a row, begun nearer to the left one: that comes last when the pen goes home from there."""
    for end, last in (("stay", 94.0), ("home", 10.0), ("bottom-right", 94.0)):
        job = prepare(str(drawing), ReadOptions(), resolve({"end": end}).values, np.array([30.0, 20.0]))
        assert job.layers[-1].strokes[-1].points_mm[-1, 0] == pytest.approx(last)


@pytest.mark.parametrize(
    ("flags", "names"),
    [
        ({}, ["notes", "10 last", "! 2 first"]),
        ({"reverse": True}, ["! 2 first", "10 last", "notes"]),
        ({"group": "number"}, ["! 2 first", "10 last", "notes"]),
        ({"group": "number", "reverse": True}, ["notes", "10 last", "! 2 first"]),
        ({"group": "color"}, ["#000000", "#ff0000"]),
        ({"group": "color", "reverse": True}, ["#ff0000", "#000000"]),
    ],
)
def test_layers_come_in_the_order_asked_for(flags: dict[str, Any], names: list[str], drawing: Path) -> None:
    drawing.write_text(LAYERS)
    actions = planned(prepare(str(drawing), ReadOptions(), resolve(flags).values))
    assert [action.name for action in actions if isinstance(action, LayerStart)] == names


def test_a_random_order_is_another_for_each_seed_and_the_same_for_one(drawing: Path) -> None:
    lines = "".join(f'<path d="M{5 + 3 * k} 10v20"/>' for k in range(20))
    drawing.write_text(DRAWING.split("<path", 1)[0] + lines + "</svg>")

    def order(**flags: Any) -> list[float]:
        actions = planned(prepare(str(drawing), ReadOptions(), resolve({"order": "random", **flags}).values))
        return [round(float(action.motion.start_mm[0])) for action in actions if isinstance(action, Draw)]

    first, again, other = order(), order(), order(seed=1)
    assert first == again
    assert first != other
    assert sorted(first) == sorted(other) == [5 + 3 * k for k in range(20)]
    # No two neighbours in a row more often than chance has it: one in ten.
    assert sum(abs(a - b) == 3 for a, b in pairwise(first)) < 6


def test_the_virtual_boards_here_is_said_to_be_home(drawing: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record = tmp_path / "record.json"
    sim = ["--port", "sim", "--speed", "50", "--record", str(record)]
    assert run(["plot", str(drawing), "--start", "here", *sim]) == 0
    assert "note: --start here: the virtual board has just been switched on, so that here is home" in capsys.readouterr().err
    ink = ink_mm(json.loads(record.read_text()), MACHINE.kinematics())
    assert np.allclose(ink[0][[0, -1]], [[10, 10], [14, 10]], atol=0.02)
    assert run(["plot", str(drawing), *sim]) == 0
    assert "here" not in capsys.readouterr().err
