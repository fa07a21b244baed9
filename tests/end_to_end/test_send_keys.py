"""`plotter send` at a terminal and without one: what its keys and signals do, and what is said of pen, motors and next step."""

from __future__ import annotations

import os
import pty
import select
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from output.ebb.virtual.process import VirtualBoard, start_virtual_board
from plotter.cli.main import run
from tests.end_to_end.test_resume import check_stopped, check_whole, wait_for_motion

# A line of seven seconds, and two short ones; the second layer begins with a pause.
DRAWING = """<svg xmlns="http://www.w3.org/2000/svg" xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape"
 width="100mm" height="60mm" viewBox="0 0 100 60" stroke="black">
 <g inkscape:groupmode="layer" inkscape:label="1"><path d="M10 10H90"/></g>
 <g inkscape:groupmode="layer" inkscape:label="!2"><path d="M10 30H20"/><path d="M10 50H20"/></g></svg>"""
PROGRAM = "import sys; from plotter.cli.main import main; main(sys.argv[1:])"


@pytest.fixture
def commands(drawing: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """The drawing's command file."""
    file = drawing.with_suffix(".ebb")
    assert run(["export", str(drawing), "-o", str(file), "--draw-speed", "12mm/s"]) == 0, capsys.readouterr().err
    return file


class Terminal:
    """The program, or another, on a terminal of its own."""

    def __init__(self, *arguments: str, code: str = PROGRAM) -> None:
        self.child, self.master = pty.fork()
        if self.child == 0:
            environment = {**os.environ, "TERM": "xterm", "COLUMNS": "250"}
            os.execve(sys.executable, [sys.executable, "-c", code, *arguments], environment)
        self.text = ""
        self.code: int | None = None

    def __enter__(self) -> Terminal:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self.master)
        if self.code is None:
            os.kill(self.child, signal.SIGKILL)
            os.waitpid(self.child, 0)

    def type(self, keys: bytes) -> None:
        os.write(self.master, keys)

    def read(self, wait_s: float = 0.05) -> bool:
        """Reads what is there; False when the program has closed it."""
        while select.select([self.master], [], [], wait_s)[0]:
            try:
                data = os.read(self.master, 65536)
            except OSError:
                return False
            self.text += data.decode("utf-8", "replace")
        return True

    def wait_for(self, wanted: str, timeout_s: float = 15.0) -> None:
        end = time.monotonic() + timeout_s
        while wanted not in self.text:
            assert time.monotonic() < end, f"{wanted!r} did not come, but {self.text[-800:]!r}"
            assert self.read(), self.text[-800:]

    def ended(self, timeout_s: float = 40.0) -> int:
        """The exit code."""
        end = time.monotonic() + timeout_s
        while self.code is None:
            assert time.monotonic() < end, f"it has not ended, but said {self.text[-800:]!r}"
            self.read()
            child, status = os.waitpid(self.child, os.WNOHANG)
            self.code = os.waitstatus_to_exitcode(status) if child else None
        self.read()
        return self.code


def test_send_knows_no_home(commands: Path, drawing: Path) -> None:
    """`h` is not offered in a pause, and does nothing there or before."""
    with start_virtual_board() as board, Terminal("send", str(commands), "--port", board.port) as terminal:
        wait_for_motion(board)
        terminal.type(b"h")
        terminal.wait_for("ends the plot")  # the pause of the drawing's own
        assert "next: !2" in terminal.text
        assert "goes home" not in terminal.text
        terminal.type(b"h")
        time.sleep(0.5)
        assert "going home" not in terminal.text
        terminal.type(b"p")
        assert terminal.ended() == 0, terminal.text
        check_whole(board, drawing)


def test_send_says_that_a_pause_is_on_its_way(commands: Path) -> None:
    """It begins before the next stroke of the file, five seconds later."""
    with start_virtual_board() as board, Terminal("send", str(commands), "--port", board.port) as terminal:
        wait_for_motion(board)
        time.sleep(1.5)
        terminal.read()
        assert "pausing" not in terminal.text
        terminal.type(b"p")
        terminal.wait_for("pausing", 2.5)
        terminal.wait_for("ends the plot")
        terminal.type(b"q")
        assert terminal.ended() == 130
        check_stopped(board)


def sending(commands: Path, board: VirtualBoard) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-c", PROGRAM, "send", str(commands), "--port", board.port]
    quiet: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, env=os.environ, **quiet)


def test_ctrl_c_ends_what_is_sent_and_names_the_next_step(commands: Path) -> None:
    with start_virtual_board() as board:
        process = sending(commands, board)
        wait_for_motion(board)
        time.sleep(0.8)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=30)
        assert process.returncode == 130
        assert b"stopped by Ctrl-C" in errors
        assert b"the pen is up and the motors are off: push the carriage to its home corner" in errors
        assert b"resume" not in errors
        check_stopped(board)
