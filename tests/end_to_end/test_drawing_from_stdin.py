"""A drawing that is read from standard input: keys and Ctrl-C are as for a file, only that it cannot be resumed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from output.ebb.virtual.process import VirtualBoard, start_virtual_board
from plotter.cli.main import run
from plotter.journals import given_up
from tests.end_to_end.test_resume import check_stopped, check_whole, wait_for_motion
from tests.end_to_end.test_send_keys import PROGRAM, Terminal

DRAWING = """<svg xmlns="http://www.w3.org/2000/svg" width="100mm" height="60mm" viewBox="0 0 100 60" stroke="black">
  <path d="M10 10C40 -10 60 50 90 20"/><path d="M90 30C60 60 40 10 10 40"/></svg>"""


def piped(drawing: Path, board: VirtualBoard) -> Terminal:
    pipeline = f"trap : INT; cat {drawing} | exec {sys.executable} -c '{PROGRAM}' plot - --port {board.port}"
    code = "import os, sys; os.execvp('sh', ['sh', '-c', sys.argv[1]])"
    return Terminal(pipeline, code=code)


def test_keys_come_from_the_terminal_that_the_drawing_did_not_come_from(drawing: Path) -> None:
    with start_virtual_board() as board, piped(drawing, board) as terminal:
        wait_for_motion(board)
        time.sleep(1.0)
        terminal.type(b"p")
        terminal.wait_for("paused by key: p or the board's button goes on, h goes home")
        terminal.type(b"p")
        assert terminal.ended() == 0, terminal.text
        check_whole(board, drawing)


def test_ctrl_c_once_pauses_and_twice_stops(drawing: Path) -> None:
    with start_virtual_board() as board, piped(drawing, board) as terminal:
        wait_for_motion(board)
        time.sleep(1.0)
        terminal.type(b"\x03")
        terminal.wait_for("paused by Ctrl-C: p or")
        assert all(board.state()["motors_on"])
        terminal.type(b"\x03")
        assert terminal.ended() == 130
        assert "push the carriage to its home corner before the next plot" in terminal.text
        assert "resume" not in terminal.text
        check_stopped(board)


def test_without_any_terminal_ctrl_c_pauses_and_ends_motors_on(drawing: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with start_virtual_board() as board:
        with drawing.open("rb") as source:
            process = subprocess.Popen(
                [sys.executable, "-c", PROGRAM, "plot", "-", "--port", board.port],
                env=os.environ,
                stdin=source,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                start_new_session=True,
            )
        wait_for_motion(board)
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=30)
        assert process.returncode == 5, errors
        assert b"the pen is up and the motors hold; a drawing from standard input cannot be resumed" in errors
        assert b"`plotter home` brings the carriage home, `plotter disable` lets go of it" in errors
        state = board.state()
        assert state["pen_up"]
        assert all(state["motors_on"])
        assert given_up() is None, "it never could be resumed"
        assert run(["home", "--port", board.port]) == 0, capsys.readouterr().err
        assert board.state()["position"] == [0, 0]
