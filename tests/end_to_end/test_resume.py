"""A plot that is killed is finished by `plotter resume`, every line drawn once; what is not as it was is refused by name."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from output.ebb.verify_compare import compare
from output.ebb.virtual.process import VirtualBoard, start_virtual_board
from plotter.cli.main import run
from plotter.cli.plot import ink_mm
from plotter.machines.profile import load_machine
from plotter.svg.read import read_drawing

MACHINE = load_machine("axidraw-v3")
DRAWING = """<svg xmlns="http://www.w3.org/2000/svg" width="100mm" height="60mm" viewBox="0 0 100 60" stroke="black">
  <path d="M10 10C40 -10 60 50 90 20"/><path d="M90 30C60 60 40 10 10 40"/><circle cx="50" cy="30" r="12"/>
  <path d="M10 50L30 45L50 55L70 45L90 50"/></svg>"""


@pytest.fixture
def drawing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    file = tmp_path / "drawing.svg"
    file.write_text(DRAWING)
    return file


def plotting(drawing: Path, board: VirtualBoard, *flags: str, **streams: Any) -> subprocess.Popen[bytes]:
    code = "import sys; from plotter.cli.main import main; main(sys.argv[1:])"
    command = [sys.executable, "-c", code, "plot", str(drawing), "--port", board.port, *flags]
    streams.setdefault("stdin", subprocess.DEVNULL)
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=os.environ, **streams)


def wait_for_motion(board: VirtualBoard, start: Sequence[int] = (0, 0)) -> None:
    deadline = time.monotonic() + 30
    while board.state()["position"] == list(start) and time.monotonic() < deadline:
        time.sleep(0.02)


def plot_and_kill(drawing: Path, board: VirtualBoard, after_s: float, *how: signal.Signals) -> int:
    """Start a plot in a process of its own and send it `how`, `after_s` after its first motion; its exit code."""
    process = plotting(drawing, board)
    wait_for_motion(board)
    time.sleep(after_s)
    for number in how:
        process.send_signal(number)
        time.sleep(0.05)
    _, errors = process.communicate(timeout=30)
    assert b"Traceback" not in errors
    return process.returncode


def ink(board: VirtualBoard) -> list[np.ndarray]:
    return ink_mm(board.record(), MACHINE.kinematics())


def check_whole(board: VirtualBoard, drawing: Path) -> None:
    """Old and new ink together are the drawing, and where the pen was taken up again at most 0.2 mm are drawn twice."""
    wanted = [stroke.points_mm for layer in read_drawing(drawing).layers for stroke in layer.strokes]
    drawn = ink(board)
    deviation = compare(drawn, wanted)
    assert deviation.drawn.max_mm <= 0.05
    assert deviation.wanted.max_mm <= 0.05
    assert len(drawn) > len(wanted) - 1
    for before, after in pairwise(drawn):
        distance_mm = float(np.hypot(*(after[0] - before[-1])))
        assert distance_mm <= 0.2 or distance_mm > 1.0


@pytest.mark.parametrize("after_s", [0.3, 1.3, 3.1, 5.2])
def test_killed_and_resumed(after_s: float, drawing: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with start_virtual_board() as board:
        assert plot_and_kill(drawing, board, after_s, signal.SIGKILL) == -signal.SIGKILL
        assert run(["resume", "--port", board.port]) == 0
        assert "resumed drawing.svg" in capsys.readouterr().out
        check_whole(board, drawing)
        state: dict[str, Any] = board.state()
        assert state["pen_up"]
        assert run(["resume", "--port", board.port]) == 2
        assert "finished" in capsys.readouterr().err


def test_a_plot_from_where_the_pen_was_is_resumed(drawing: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its order depends on where it began, and its counters went on from there."""
    with start_virtual_board() as board:
        assert run(["move", "--to", "95mm", "55mm", "--port", board.port]) == 0
        here = board.state()["position"]
        process = plotting(drawing, board, "--start", "here", "--end", "stay")
        wait_for_motion(board, here)
        time.sleep(2.0)
        process.kill()
        process.communicate(timeout=30)
        assert run(["resume", "--port", board.port]) == 0, capsys.readouterr().err
        check_whole(board, drawing)


def test_a_plot_with_dips_is_resumed(drawing: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is left begins with a dip, and the ink beside the well is the drawing."""
    with start_virtual_board() as board:
        process = plotting(drawing, board, "--reink-every", "60mm", "--well", "150mm,5mm", "--dip", "100ms")
        wait_for_motion(board)
        time.sleep(5.0)
        process.kill()
        process.communicate(timeout=30)
        assert run(["resume", "--port", board.port]) == 0, capsys.readouterr().err
        lines = [line for line in ink(board) if np.abs(line - (150.0, 5.0)).max() > 0.02]
        assert len(ink(board)) - len(lines) >= 4
        wanted = [stroke.points_mm for layer in read_drawing(drawing).layers for stroke in layer.strokes]
        deviation = compare(lines, wanted)
        assert deviation.drawn.max_mm <= 0.05
        assert deviation.wanted.max_mm <= 0.05


def test_killed_twice(drawing: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with start_virtual_board() as board:
        plot_and_kill(drawing, board, 1.0, signal.SIGKILL)
        code = "import sys; from plotter.cli.main import main; main(sys.argv[1:])"
        command = [sys.executable, "-c", code, "resume", "--port", board.port]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env=os.environ)
        time.sleep(5.0)
        process.kill()
        process.wait()
        assert run(["resume", "--port", board.port]) == 0, capsys.readouterr().err
        check_whole(board, drawing)


def test_nothing_to_resume(drawing: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["resume", "--port", str(drawing)]) == 2
    assert "no interrupted plot" in capsys.readouterr().err


def test_what_has_changed_is_named(drawing: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with start_virtual_board(pty=tmp_path / "ebb") as board:
        plot_and_kill(drawing, board, 0.5, signal.SIGKILL)
        before = board.record()["stepper_moves"]
        drawing.write_text(DRAWING.replace('r="12"', 'r="13"'))
        assert run(["resume", "--port", board.port]) == 2
        assert "drawing was" in capsys.readouterr().err
        drawing.write_text(DRAWING)
        board.control("reboot")
        time.sleep(2.0)
        assert run(["resume", "--port", str(tmp_path / "ebb")]) == 3
        assert "plotter resume --homed" in capsys.readouterr().err
        assert board.record()["stepper_moves"] <= before + 64


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_raises_the_pen_and_exits_130(how: signal.Signals, drawing: Path) -> None:
    with start_virtual_board() as board:
        assert plot_and_kill(drawing, board, 1.5, how) == 130
        check_stopped(board)


def check_stopped(board: VirtualBoard) -> None:
    time.sleep(0.3)
    state = board.state()
    assert state["pen_up"]
    assert state["idle"]
    assert not any(state["motors_on"])


def test_ctrl_c_without_a_terminal_pauses_on_the_path_and_is_resumed(drawing: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with start_virtual_board() as board:
        assert plot_and_kill(drawing, board, 1.5, signal.SIGINT) == 5
        state = board.state()
        assert state["pen_up"]
        assert state["idle"]
        assert all(state["motors_on"])
        assert run(["resume", "--port", board.port]) == 0, capsys.readouterr().err
        check_whole(board, drawing)


def test_two_ctrl_cs_stop(drawing: Path) -> None:
    with start_virtual_board() as board:
        assert plot_and_kill(drawing, board, 1.5, signal.SIGINT, signal.SIGINT) == 130
        check_stopped(board)


def test_keys_of_a_terminal_pause_and_go_on(drawing: Path) -> None:
    master, slave = pty.openpty()
    with start_virtual_board() as board:
        process = plotting(drawing, board, stdin=slave)
        wait_for_motion(board)
        time.sleep(1.5)
        for _ in range(2):
            os.write(master, b"p")
            deadline = time.monotonic() + 5
            while not (board.state()["pen_up"] and board.state()["idle"]) and time.monotonic() < deadline:
                time.sleep(0.05)
            time.sleep(1.5)
            moves = board.record()["stepper_moves"]
            time.sleep(0.5)
            assert board.record()["stepper_moves"] == moves, "the plot goes on although it is paused"
            os.write(master, b"p")
            time.sleep(1.0)
        _, errors = process.communicate(timeout=30)
        assert process.returncode == 0, errors
        assert errors.count(b"paused by key") == 2
        check_whole(board, drawing)
    os.close(master)
    os.close(slave)
