"""A terminal that takes nothing any more, stopped by Ctrl-S or its connection dead: neither plot nor program waits for it."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from output.ebb.journal import load
from output.ebb.virtual.process import VirtualBoard, start_virtual_board
from plotter.journals import journal_path
from tests.end_to_end.test_resume import check_stopped, check_whole, wait_for_motion
from tests.end_to_end.test_send_keys import Terminal

DRAWING = """<svg xmlns="http://www.w3.org/2000/svg" width="100mm" height="60mm" viewBox="0 0 100 60" stroke="black">
  <path d="M10 10C40 -10 60 50 90 20"/><path d="M90 30C60 60 40 10 10 40"/>
  <circle cx="50" cy="30" r="12"/><path d="M10 50L30 45L50 55L70 45L90 50L10 55L90 58L10 59"/></svg>"""
CTRL_S = b"\x13"


def still(board: VirtualBoard) -> None:
    end = time.monotonic() + 10
    while not (board.state()["pen_up"] and board.state()["idle"]):
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.mark.parametrize("paused", [False, True])
def test_sigterm_ends_a_plot_whose_terminal_takes_nothing(paused: bool, drawing: Path) -> None:
    with start_virtual_board() as board, Terminal("plot", str(drawing), "--port", board.port) as terminal:
        wait_for_motion(board)
        time.sleep(0.8)
        terminal.type(CTRL_S)
        time.sleep(0.5)
        if paused:
            os.kill(terminal.child, signal.SIGINT)
            time.sleep(0.5)
            still(board)
            time.sleep(1.0)
        os.kill(terminal.child, signal.SIGTERM)
        assert terminal.ended(8.0) == 130
        check_stopped(board)
        state = load(journal_path())
        assert state is not None
        assert state.ended == "stopped"


def test_a_plot_whose_terminal_takes_nothing_comes_to_its_end(drawing: Path) -> None:
    with start_virtual_board(speed=4) as board, Terminal("plot", str(drawing), "--port", board.port) as terminal:
        wait_for_motion(board)
        terminal.type(CTRL_S)
        assert terminal.ended(20.0) == 0
        check_whole(board, drawing)


def test_a_terminal_that_takes_something_again_shows_everything(drawing: Path) -> None:
    with start_virtual_board() as board, Terminal("plot", str(drawing), "--port", board.port) as terminal:
        wait_for_motion(board)
        terminal.type(CTRL_S)
        time.sleep(0.5)
        os.kill(terminal.child, signal.SIGINT)
        time.sleep(3.0)
        terminal.read()
        assert "paused by" not in terminal.text
        terminal.type(b"\x11")
        terminal.wait_for("paused by Ctrl-C: p or")
        terminal.type(b"p")
        assert terminal.ended() == 0
        assert "plotted drawing.svg" in terminal.text
        check_whole(board, drawing)
