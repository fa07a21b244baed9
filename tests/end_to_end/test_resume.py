"""A plot that is killed is finished by `plotter resume`, every line drawn once; what is not as it was is refused by name."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from output.ebb.journal import load
from output.ebb.ports import FoundPort, wait_for_board
from output.ebb.verify_compare import compare
from output.ebb.virtual.process import VirtualBoard, start_virtual_board
from plotter.cli.main import run
from plotter.cli.plot import ink_mm
from plotter.journals import given_up, journal_path
from plotter.machines.profile import load_machine
from plotter.svg.read import read_drawing

MACHINE = load_machine("axidraw-v3")
DRAWING = """<svg xmlns="http://www.w3.org/2000/svg" width="100mm" height="60mm" viewBox="0 0 100 60" stroke="black">
  <path d="M10 10C40 -10 60 50 90 20"/><path d="M90 30C60 60 40 10 10 40"/><circle cx="50" cy="30" r="12"/>
  <path d="M10 50L30 45L50 55L70 45L90 50"/></svg>"""


class Screen:
    """Reads what a program shows on its terminal, and goes on reading."""

    def __init__(self, master: int) -> None:
        self._master = master
        self._shown = b""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        with suppress(OSError):  # how a terminal ends whose program has gone
            while data := os.read(self._master, 4096):
                self._shown += data

    def all(self) -> bytes:
        """Everything, once the program has gone. The terminal is closed."""
        self._reader.join(5.0)
        os.close(self._master)
        return self._shown


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


def test_a_plot_that_was_killed_after_its_last_command_is_finished(drawing: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The motors are off by then, so that the position is nobody's any more, but no line is left to draw either."""
    with start_virtual_board() as board:
        process = plotting(drawing, board)
        process.communicate(timeout=120)
        assert process.returncode == 0
        lines = journal_path().read_bytes().splitlines(keepends=True)
        assert b'"end"' in lines[-1]
        journal_path().write_bytes(b"".join(lines[:-1]))
        before = board.record()["ink"]
        assert run(["resume", "--port", board.port]) == 0, capsys.readouterr().err
        assert "all of it had been drawn" in capsys.readouterr().out
        assert board.record()["ink"] == before
        assert run(["resume", "--port", board.port]) == 2


def test_after_a_kill_the_board_finished_by_itself_or_its_motors_were_let_go(
    drawing: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A second of motion is on the board: killed in its last one, a plot runs to its end. Motors let go by hand differ."""
    with start_virtual_board() as board:
        process = plotting(drawing, board)
        deadline = time.monotonic() + 60
        while not any(line == "EM,0,0" for _, _, line in board.record()["wire"]) and time.monotonic() < deadline:
            time.sleep(0.05)
        process.kill()
        process.communicate(timeout=30)
        assert process.returncode == -signal.SIGKILL
        assert run(["resume", "--port", board.port]) == 0, capsys.readouterr().err
        assert "all of it had been drawn" in capsys.readouterr().out
        check_whole(board, drawing)
    with start_virtual_board() as board:
        plot_and_kill(drawing, board, 2.0, signal.SIGKILL)
        assert run(["align", "--port", board.port]) == 0
        assert run(["resume", "--port", board.port]) == 3
        assert "plotter resume --homed" in capsys.readouterr().err


def test_what_the_board_alone_can_refuse_does_not_wait_for_the_drawing(
    drawing: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The plot was cut off in its first stroke, so that there is no question whether all of it was drawn."""
    with start_virtual_board() as board:
        plot_and_kill(drawing, board, 1.3, signal.SIGKILL)

    def read_again(_state: object) -> None:
        raise AssertionError("the drawing is read")

    monkeypatch.setattr("plotter.cli.resume.made_again", read_again)
    with start_virtual_board() as board:
        assert run(["resume", "--port", board.port]) == 3
        assert "restarted" in capsys.readouterr().err
        monkeypatch.setattr("plotter.cli.say.sys.stderr.isatty", lambda: True)
        assert run(["resume", "--port", board.port, "--homed"]) == 1
        assert f"reading {drawing} again" in capsys.readouterr().err


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


def test_two_ctrl_cs_stop_and_say_how_to_go_on(drawing: Path) -> None:
    with start_virtual_board() as board:
        process = plotting(drawing, board)
        wait_for_motion(board)
        time.sleep(1.5)
        process.send_signal(signal.SIGINT)
        time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=30)
        assert process.returncode == 130
        assert b"push the carriage to its home corner, then `plotter resume --homed`" in errors
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


@pytest.mark.parametrize("keys", [b"", b"q"])
def test_the_last_message_is_read_however_often_ctrl_c_is_pressed(keys: bytes, drawing: Path) -> None:
    """Every 10 ms from the first key to the end: also while bar and keys are put away, and between the streams of a plot."""
    with start_virtual_board() as board:
        code = "import sys; from plotter.cli.main import main; main(sys.argv[1:])"
        child, master = pty.fork()
        if child == 0:
            os.execve(sys.executable, [sys.executable, "-c", code, "plot", str(drawing), "--port", board.port], os.environ)
        screen = Screen(master)
        wait_for_motion(board)
        time.sleep(1.0)
        os.write(master, keys)
        ended, status = os.waitpid(child, os.WNOHANG)
        while not ended:
            os.kill(child, signal.SIGINT)  # without the terminal's part in it, which is to forget what is not shown yet
            time.sleep(0.01)
            ended, status = os.waitpid(child, os.WNOHANG)
        shown = screen.all()
        assert os.waitstatus_to_exitcode(status) == 130
        assert b"then `plotter resume --homed` to go on with it" in shown, shown[-300:]
        check_stopped(board)
        state = load(journal_path())
        assert state is not None
        assert state.ended == "stopped"


def test_ctrl_c_after_the_last_line_does_not_make_a_failure_of_it(drawing: Path) -> None:
    drawing.write_text(DRAWING.replace(DRAWING[DRAWING.index("<path") :], '<path d="M5 5h3"/></svg>'))
    with start_virtual_board() as board:
        process = plotting(drawing, board)
        deadline = time.monotonic() + 30
        while process.poll() is None and time.monotonic() < deadline:
            state = load(journal_path())
            if state is not None and state.ended is not None:
                process.send_signal(signal.SIGINT)
            time.sleep(0.005)
        _, errors = process.communicate(timeout=5)
        assert process.returncode == 0, errors


def test_a_closed_terminal_raises_the_pen_and_the_journal_knows(drawing: Path) -> None:
    """The terminal goes with its session: SIGHUP, keys that cannot be read, a bar that cannot be drawn, a message to nobody."""
    with start_virtual_board() as board:
        code = "import sys; from plotter.cli.main import main; main(sys.argv[1:])"
        child, master = pty.fork()
        if child == 0:
            os.execve(sys.executable, [sys.executable, "-c", code, "plot", str(drawing), "--port", board.port], os.environ)
        wait_for_motion(board)
        time.sleep(0.5)
        os.close(master)
        _, status = os.waitpid(child, 0)
        assert os.waitstatus_to_exitcode(status) == 130
        check_stopped(board)
        state = load(journal_path())
        assert state is not None
        assert state.ended == "stopped"


def test_a_board_that_reads_nothing_any_more_does_not_hold_the_program(drawing: Path) -> None:
    with start_virtual_board() as board:
        process = plotting(drawing, board)
        wait_for_motion(board)
        time.sleep(0.5)
        os.kill(board.pid, signal.SIGSTOP)
        try:
            process.send_signal(signal.SIGTERM)
            began = time.monotonic()
            _, errors = process.communicate(timeout=20)
        finally:
            os.kill(board.pid, signal.SIGCONT)
        assert process.returncode == 130
        assert b"THE PEN MAY BE DOWN" in errors
        assert time.monotonic() - began < 10


def test_a_cable_that_was_pulled_and_is_in_again_under_another_name(
    drawing: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The board has been under power all the time; it is found by the plot's nickname, and every line is drawn once."""
    other = tmp_path / "ebb1"
    fault = {"fault": "hangup_and_return", "at": {"stroke": 2}, "after_real_s": 1, "pty": str(other)}
    with start_virtual_board(nickname="East", faults=[fault], pty=tmp_path / "ebb0") as board:
        process = plotting(drawing, board)
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 4
        assert b"lost" in errors
        lists = iter([[], [FoundPort("/dev/other", "West")], [FoundPort("/dev/other", "West"), FoundPort(str(other), "East")]])
        monkeypatch.setattr("plotter.cli.resume.wait_for_board", partial(wait_for_board, find=lambda: next(lists)))
        time.sleep(2.0)
        assert run(["resume"]) == 0, capsys.readouterr().err
        check_whole(board, drawing)


def test_a_port_that_no_list_has_is_found_again(drawing: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The port that the plot was given by name, here a link to a pseudo-terminal, is in its journal."""
    with start_virtual_board(pty=tmp_path / "ebb") as board:
        link = str(tmp_path / "ebb")
        process = plotting(drawing, board, "--port", link)
        wait_for_motion(board)
        time.sleep(1.0)
        process.kill()
        process.communicate(timeout=30)
        assert run(["resume"]) == 0, capsys.readouterr().err
        check_whole(board, drawing)


def test_a_numbered_terminal_is_not_opened_unasked(drawing: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its number may be another's by now."""
    with start_virtual_board() as board:
        plot_and_kill(drawing, board, 0.3, signal.SIGKILL)
        before = board.record()["stepper_moves"]
        assert run(["resume"]) == 4
        assert "no EiBotBoard is plugged in" in capsys.readouterr().err
        time.sleep(1.5)
        assert board.record()["stepper_moves"] <= before + 64


def test_a_new_plot_says_what_it_takes_the_place_of(drawing: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with start_virtual_board(speed=20, patience_s=0.2) as board:
        assert given_up() is None
        plot_and_kill(drawing, board, 0.1, signal.SIGKILL)
        assert run(["plot", str(drawing), "--port", board.port]) == 0
        said = capsys.readouterr().err
        assert f"the plot of {drawing}, begun 20" in said
        assert "was interrupted after" in said
        assert given_up() is None


def test_a_plot_that_ends_while_it_is_still_being_ordered_ends_quietly(drawing: Path) -> None:
    rng = np.random.default_rng(2)
    places = rng.uniform((10, 10), (90, 50), (3000, 2)).round(2).tolist()
    drawing.write_text(DRAWING.replace("</svg>", "".join(f'<path d="M{x} {y}h1"/>' for x, y in places) + "</svg>"))
    with start_virtual_board() as board:
        process = plotting(drawing, board)
        wait_for_motion(board)
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=30)
        assert process.returncode == 130
        assert len(errors.decode().splitlines()) == 1, errors.decode()
        check_stopped(board)
