"""Standard streams that are closed, full or not read: what was drawn is said to be done, and nothing ends in a traceback."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from output.ebb.journal import load
from output.ebb.virtual.process import VirtualBoard, start_virtual_board
from plotter.journals import journal_path

DRAWING = """<svg xmlns="http://www.w3.org/2000/svg" width="40mm" height="20mm" viewBox="0 0 40 20" stroke="black">
  <path d="M5 5H9"/></svg>"""
PLOTTER = 'exec "$0" -c "import sys; from plotter.cli.main import main; main(sys.argv[1:])" "$@"'


def called(redirection: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """The program with its streams redirected by a shell, which can close them."""
    command = ["sh", "-c", f"{PLOTTER} {redirection}", sys.executable, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, env=os.environ)


def check_drawn(board: VirtualBoard, done: subprocess.CompletedProcess[str]) -> None:
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert len(board.record()["ink"]) == 1
    state = load(journal_path())
    assert state is not None
    assert state.ended == "done"


@pytest.mark.parametrize("redirection", ["<&-", "2>&-", "<&- >&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_closed_streams_are_no_hindrance(redirection: str, drawing: Path) -> None:
    with start_virtual_board(speed=20, patience_s=0.2) as board:
        check_drawn(board, called(redirection, "plot", str(drawing), "--port", board.port))


def test_a_closed_stream_has_no_port_in_its_place(drawing: Path) -> None:
    """Descriptor 2 would be the next that is opened: notes, written there, would reach the board."""
    with start_virtual_board(speed=20, patience_s=0.2) as board:
        check_drawn(board, called("2>&-", "plot", str(drawing), "--port", board.port))
        assert not [line for _, _, line in board.record()["wire"] if "note" in line or "plotter" in line]
    assert called("<&- 2>&-", "plot", str(drawing), "--port", "sim", "--speed", "20").returncode == 0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
@pytest.mark.parametrize("redirection", [">/dev/full", "2>/dev/full", ">/dev/full 2>&1"])
def test_a_plot_that_is_drawn_is_done_wherever_its_message_goes(redirection: str, drawing: Path) -> None:
    with start_virtual_board(speed=20, patience_s=0.2) as board:
        done = called(redirection, "plot", str(drawing), "--port", board.port)
        check_drawn(board, done)
    assert redirection != ">/dev/full" or "plotted drawing.svg" in done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_output_that_finds_no_room_is_an_error_in_one_sentence(drawing: Path) -> None:
    for arguments in (["preview", str(drawing), "--json"], ["export", str(drawing), "-o", "-"], ["machines"], ["--help"]):
        done = called(">/dev/full", *arguments)
        assert done.returncode == 2, arguments
        assert done.stderr.startswith("plotter: the output cannot be written (No space left on device)"), arguments
        assert len(done.stderr.splitlines()) == 1


def test_a_reader_that_has_gone_is_no_error(drawing: Path) -> None:
    done = called("| true", "export", str(drawing), "-o", "-")
    assert (done.returncode, done.stderr) == (0, "")
