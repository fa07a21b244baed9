"""Ctrl-Z, `fg`, `bg` and `&` in a real shell: the pen never sleeps on the paper, and the terminal is nobody's trap."""

from __future__ import annotations

import os
import pty
import re
import select
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from output.ebb.journal import load
from output.ebb.virtual.process import VirtualBoard, start_virtual_board
from plotter.journals import journal_path
from tests.end_to_end.test_resume import DRAWING, check_whole, plotting, wait_for_motion  # noqa: F401 - DRAWING is the fixture's

BASH = shutil.which("bash")
needs_bash = pytest.mark.skipif(BASH is None, reason="bash is the shell with job control here")


class Shell:
    """An interactive bash on a terminal of its own, as a user has it."""

    def __init__(self, term: str = "dumb") -> None:
        assert BASH is not None
        self.child, self.master = pty.fork()
        if self.child == 0:
            os.execve(BASH, [BASH, "--norc", "--noprofile", "-i"], {**os.environ, "PS1": "$ ", "TERM": term})
        self.text = ""

    def __enter__(self) -> Shell:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self.master)
        os.kill(self.child, signal.SIGKILL)
        os.waitpid(self.child, 0)

    def type(self, text: str) -> None:
        self.text = ""
        os.write(self.master, text.encode())

    def wait_for(self, wanted: str, timeout_s: float = 15.0) -> str:
        """Reads until `wanted` (a pattern) is there."""
        end = time.monotonic() + timeout_s
        while not re.search(wanted, self.text):
            assert time.monotonic() < end, f"{wanted!r} did not come, but {self.text[-800:]!r}"
            if select.select([self.master], [], [], 0.05)[0]:
                self.text += os.read(self.master, 65536).decode("utf-8", "replace")
        return self.text

    def plot(self, file: Path, board: VirtualBoard, then: str = "") -> None:
        program = "from plotter.cli.main import main; main()"
        self.type(f"{sys.executable} -c '{program}' plot {file} --port {board.port} {then}\n")
        wait_for_motion(board)


def rests(board: VirtualBoard) -> None:
    """Pen up, nothing moves, and that stays so."""
    before = board.state()
    assert before["pen_up"]
    assert before["idle"]
    time.sleep(0.7)
    assert board.state()["position"] == before["position"]


@needs_bash
def test_ctrl_z_sleeps_in_a_pause_and_fg_comes_back_to_it(drawing: Path) -> None:
    with start_virtual_board() as board, Shell() as shell:
        shell.plot(drawing, board)
        time.sleep(1.0)
        shell.type("\x1a")
        shell.wait_for("paused by Ctrl-Z")
        shell.wait_for(r"suspended with the pen up")
        shell.wait_for(r"Stopped")
        rests(board)
        shell.type("stty -a | tr ' ' '\\n' | grep -E '^-?icanon'; echo is-the-mode\n")
        assert "-icanon" not in shell.wait_for(r"icanon\s+is-the-mode")
        shell.type("fg\n")
        shell.wait_for("still paused: p or")
        rests(board)
        shell.type("\x1a")
        shell.wait_for("Stopped")
        shell.type("fg\n")
        shell.wait_for("still paused: p or")
        shell.type("p")
        shell.wait_for("plotted drawing.svg", 60)
        check_whole(board, drawing)
        assert not [gap for gap in board.record()["gaps"] if gap[2]], "it stopped dead with the pen down"


@needs_bash
def test_bg_leaves_it_paused_and_fg_brings_the_keys(drawing: Path) -> None:
    with start_virtual_board() as board, Shell() as shell:
        shell.type("stty tostop\n")  # what is written in the background would stop it as well
        shell.wait_for(r"\$ ")
        shell.plot(drawing, board)
        time.sleep(1.0)
        shell.type("\x1a")
        shell.wait_for("Stopped")
        shell.type("bg\n")
        shell.wait_for("still paused, in the background")
        shell.type("echo typed-to-the-$((40+2))\n")  # p among them: a shell's line is no key of ours
        shell.wait_for("typed-to-the-42")
        rests(board)
        shell.type("jobs\n")
        shell.wait_for("Running")
        board.control("button")
        wait_for_motion(board, board.state()["position"])
        shell.type("echo pq\n")
        shell.wait_for(r"\npq")
        time.sleep(0.5)
        shell.type("fg\n")
        shell.wait_for("the keys work again")
        shell.type("p")
        shell.wait_for("paused by key")
        rests(board)
        shell.type("p")
        shell.wait_for("plotted drawing.svg", 60)
        check_whole(board, drawing)


@needs_bash
def test_a_plot_that_is_begun_in_the_background_is_not_stopped_by_the_terminal(drawing: Path) -> None:
    with start_virtual_board(speed=4) as board, Shell() as shell:
        shell.plot(drawing, board, "&")
        shell.type("wait; echo all-$((50+5))\n")
        assert "Stopped" not in shell.wait_for("all-55", 60)
        check_whole(board, drawing)


@needs_bash
def test_the_bar_is_not_drawn_over_what_is_typed_while_the_plot_is_in_the_background(drawing: Path) -> None:
    bar = "stroke [0-9]+ of"
    with start_virtual_board() as board, Shell("xterm") as shell:
        shell.plot(drawing, board, "&")
        assert not re.search(bar, text_while_typing(shell))
        shell.type("fg\n")
        shell.wait_for(bar)
        shell.type("\x1a")
        shell.wait_for("Stopped")
        shell.type("bg\n")
        shell.wait_for("in the background")
        assert not re.search(bar, text_while_typing(shell))
        shell.type("fg\n")
        shell.wait_for(bar)
        shell.type("p")
        shell.wait_for("plotted drawing.svg", 60)
        check_whole(board, drawing)


@needs_bash
def test_the_bar_is_taken_away_before_the_program_sleeps(drawing: Path) -> None:
    """Else `pausing` would stand above the shell's `Stopped` for as long as it sleeps."""
    with start_virtual_board() as board, Shell("xterm") as shell:
        shell.plot(drawing, board)
        shell.wait_for("stroke [0-9]+ of")
        shell.type("\x1a")
        shown = shell.wait_for("Stopped")
        left = on_screen(shown)
        assert any("suspended with the pen up" in line for line in left)
        assert not [line for line in left if "stroke" in line]
        shell.type("fg\n")
        shell.wait_for("still paused")
        shell.wait_for("stroke [0-9]+ of")
        shell.type("p")
        shell.wait_for("plotted drawing.svg", 60)


def on_screen(text: str) -> list[str]:
    """The lines that a terminal shows, without the colours; nothing of ours moves but up and to the line's beginning."""
    lines, row = [""], 0
    for number, what, plain in re.findall(r"\x1b\[\??([\d;]*)([A-Za-z])|([\r\n]|[^\x1b\r\n]+)", text):
        if what == "A":
            row -= int(number or 1)
        elif what == "K":
            lines[row] = ""
        elif plain == "\n":
            row += 1
            lines[row:] = lines[row:] or [""]
        elif plain not in ("", "\r"):
            lines[row] += plain
    return lines


def text_while_typing(shell: Shell) -> str:
    """What the terminal shows during a second at the shell's prompt, and a moment after a bar may have been there last."""
    time.sleep(0.5)
    shell.type("echo it-is-$((40+2))\n")
    shell.wait_for("it-is-42")
    shell.text = ""
    time.sleep(1.0)
    os.write(shell.master, b"echo it-is-$((40+3))\n")
    return shell.wait_for("it-is-43")


def test_without_a_terminal_sigtstp_is_a_first_ctrl_c(drawing: Path) -> None:
    with start_virtual_board() as board:
        process = plotting(drawing, board)
        wait_for_motion(board)
        time.sleep(0.8)
        process.send_signal(signal.SIGTSTP)
        try:
            _, errors = process.communicate(timeout=20)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
        assert process.returncode == 5, errors
        assert b"plotter resume" in errors
        rests(board)
        assert any(board.state()["motors_on"])
        state = load(journal_path())
        assert state is not None
        assert state.ended == "paused"
