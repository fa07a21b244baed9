"""Which plot the journal is of, whatever happens to it: the one that `plotter resume` would go on with on this paper."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from output.ebb.journal import journal_lock, load
from output.ebb.virtual.process import VirtualBoard, start_virtual_board
from plotter.cli.main import run
from plotter.journals import journal_path
from tests.end_to_end.test_resume import plot_and_kill, plotting, wait_for_motion

DRAWING = """<svg xmlns="http://www.w3.org/2000/svg" width="100mm" height="60mm" viewBox="0 0 100 60" stroke="black">
  <path d="M10 10C40 -10 60 50 90 20"/><circle cx="50" cy="30" r="12"/><path d="M10 50H90"/></svg>"""
SMALL = """<svg xmlns="http://www.w3.org/2000/svg" width="9mm" height="9mm" viewBox="0 0 9 9" stroke="black">
  <path d="M5 5h3"/></svg>"""
# Room for a journal's head, its first part and a few records, no more.
SOME_ROOM = 600


@pytest.fixture
def other(drawing: Path) -> Path:
    """Another drawing beside the first one."""
    file = drawing.with_name("other.svg")
    file.write_text(SMALL)
    return file


@pytest.fixture
def fast() -> Iterator[VirtualBoard]:
    with start_virtual_board(speed=20, patience_s=0.2) as board:
        yield board


def interrupted(drawing: Path, board: VirtualBoard) -> bytes:
    """A plot is killed on the board; its journal."""
    assert plot_and_kill(drawing, board, 0.1, signal.SIGKILL) == -signal.SIGKILL
    return journal_path().read_bytes()


def head_bytes(journal: bytes) -> int:
    return journal.index(b"\n") + 1


def room(size: int) -> Callable[[], None]:
    """For a process whose files can be so long and no longer, as on a full disk."""
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def resuming(board: VirtualBoard, room_bytes: int) -> subprocess.Popen[str]:
    code = "import sys; from plotter.cli.main import main; main(sys.argv[1:])"
    command = [sys.executable, "-c", code, "resume", "--port", board.port]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=pipe, stderr=pipe, text=True, preexec_fn=room(room_bytes))


def rewritten(journal: bytes, change: Callable[[dict[str, Any]], None]) -> bytes:
    """The journal with another head, sound all the same."""
    head = json.loads(journal[18 : head_bytes(journal)])
    change(head)
    body = json.dumps(head).encode()
    return b"%08x %08x %s\n" % (len(body), zlib.crc32(body), body) + journal[head_bytes(journal) :]


def test_a_plot_that_the_board_refuses_leaves_the_one_before(
    drawing: Path, other: Path, fast: VirtualBoard, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its own drawing would be drawn over the interrupted one."""
    before = interrupted(drawing, fast)
    fast.control("power off")
    assert run(["plot", str(other), "--port", fast.port]) == 3
    said = capsys.readouterr().err
    assert "the motors have no power" in said
    assert "takes its place" not in said
    assert journal_path().read_bytes() == before


def test_a_resume_that_the_board_refuses_can_be_had_again(
    drawing: Path, fast: VirtualBoard, capsys: pytest.CaptureFixture[str]
) -> None:
    before = interrupted(drawing, fast)
    fast.control("power off")
    assert run(["resume", "--homed", "--port", fast.port]) == 3
    assert "the motors have no power" in capsys.readouterr().err
    assert journal_path().read_bytes() == before


def test_a_drawn_plot_whose_journal_found_no_room_is_not_drawn_again(
    drawing: Path, other: Path, fast: VirtualBoard, capsys: pytest.CaptureFixture[str]
) -> None:
    before = interrupted(other, fast)
    process = plotting(drawing, fast, preexec_fn=room(head_bytes(before) + SOME_ROOM))
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    assert b"cannot be written (File too large)" in errors
    assert run(["resume", "--homed", "--port", fast.port]) == 2
    assert "no interrupted plot" in capsys.readouterr().err


def test_a_plot_without_a_journal_takes_the_place_of_the_one_before(
    drawing: Path, other: Path, fast: VirtualBoard, capsys: pytest.CaptureFixture[str]
) -> None:
    interrupted(drawing, fast)
    process = plotting(other, fast, preexec_fn=room(100))
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    notes = [line for line in errors.decode().splitlines() if line.startswith("note: ")]
    assert len(notes) == 1, notes
    assert "no journal can be written at" in notes[0]
    assert f"the plot of {drawing}, begun 20" in notes[0]
    assert "can no longer be resumed either" in notes[0]
    assert not list(journal_path().parent.glob("*.new"))
    assert run(["resume", "--homed", "--port", fast.port]) == 2
    assert "no interrupted plot" in capsys.readouterr().err


def test_a_resume_whose_journal_runs_out_of_room_promises_nothing(drawing: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with start_virtual_board() as board:
        assert plot_and_kill(drawing, board, 1.0, signal.SIGKILL) == -signal.SIGKILL
        time.sleep(1.5)
        process = resuming(board, journal_path().stat().st_size + SOME_ROOM)
        wait_for_motion(board, board.state()["position"])
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=30)
        assert process.returncode == 5, errors
        assert "note: the journal" in errors
        assert "plotter resume" not in errors
        assert run(["resume", "--port", board.port]) == 2
        assert "no interrupted plot" in capsys.readouterr().err


def test_a_resume_that_finds_no_room_at_all_leaves_everything_as_it_is(drawing: Path) -> None:
    with start_virtual_board() as board:
        assert plot_and_kill(drawing, board, 1.0, signal.SIGKILL) == -signal.SIGKILL
        time.sleep(1.5)
        before, moves = journal_path().read_bytes(), board.record()["stepper_moves"]
        process = resuming(board, len(before))
        _, errors = process.communicate(timeout=30)
        assert process.returncode == 2, errors
        assert "cannot be written (File too large)" in errors
        assert "then `plotter resume`" in errors
        assert (journal_path().read_bytes(), board.record()["stepper_moves"]) == (before, moves)


def test_a_journal_that_cannot_be_opened_for_writing_is_a_sentence(
    drawing: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    open_file = os.open

    def refused(path: Any, flags: int, *mode: int, **folder: Any) -> int:
        if path == journal_path() and flags & os.O_APPEND:
            raise PermissionError(1, "Operation not permitted", str(path))
        return open_file(path, flags, *mode, **folder)

    with start_virtual_board() as board:
        assert plot_and_kill(drawing, board, 1.0, signal.SIGKILL) == -signal.SIGKILL
        monkeypatch.setattr("output.ebb.journal.os.open", refused)
        assert run(["resume", "--port", board.port]) == 2
        said = capsys.readouterr().err
        assert f"the journal {journal_path()} cannot be written (Operation not permitted)" in said
        assert "Traceback" not in said


@pytest.mark.parametrize(
    ("then", "now", "named"),
    [
        ("80.0", "100.0", "machine steps per mm was [[80.0, "),
        ("width_mm = 300", "width_mm = 50", "machine width mm was 300.0, is 50.0"),
    ],
    ids=["another scale", "too small by now"],
)
def test_a_machine_that_is_not_as_it_was_is_named(
    then: str, now: str, named: str, drawing: Path, tmp_path: Path, fast: VirtualBoard, capsys: pytest.CaptureFixture[str]
) -> None:
    machine = tmp_path / "machine.toml"
    profile = (Path(__file__).parents[2] / "plotter/machines/axidraw-v3.toml").read_text()
    machine.write_text(profile)
    process = plotting(drawing, fast, "--machine", str(machine))
    wait_for_motion(fast)
    process.kill()
    process.communicate(timeout=30)
    machine.write_text(profile.replace(then, now))
    assert machine.read_text() != profile
    assert run(["resume", "--homed", "--port", fast.port]) == 2
    assert named in capsys.readouterr().err


@pytest.mark.parametrize("what", ["settings", "reading"])
@pytest.mark.parametrize("version", ["0.0.1", None])
def test_a_journal_of_another_version_is_refused_by_name(
    version: str | None, what: str, drawing: Path, fast: VirtualBoard, capsys: pytest.CaptureFixture[str]
) -> None:
    def older(head: dict[str, Any]) -> None:
        head[what]["gone_since"] = 1
        head["program_version"] = version or head["program_version"]

    journal_path().write_bytes(rewritten(interrupted(drawing, fast), older))
    assert run(["resume", "--port", fast.port]) == 2
    said = capsys.readouterr().err
    assert ("program version was 0.0.1, is " if version else "gone_since") in said
    assert f"plot {drawing} anew" in said


@pytest.mark.parametrize("damage", ["cut", "noise", "directory"])
def test_a_journal_that_cannot_be_read_is_said_to_be_there(
    damage: str, drawing: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = journal_path()
    path.parent.mkdir(parents=True)
    if damage == "directory":
        path.mkdir()
    else:
        path.write_bytes(b"0000005b 1c29" if damage == "cut" else bytes(range(256)) * 9)
    assert run(["resume", "--port", str(drawing)]) == 2
    assert f"the journal {path} cannot be read" in capsys.readouterr().err


def test_of_two_plots_at_once_the_first_keeps_the_journal(
    drawing: Path, other: Path, fast: VirtualBoard, capsys: pytest.CaptureFixture[str]
) -> None:
    with start_virtual_board() as board:
        process = plotting(drawing, board)
        wait_for_motion(board)
        assert run(["plot", str(other), "--port", fast.port]) == 0
        said = capsys.readouterr().err
        assert "another plot is running and keeps the journal: this one cannot be resumed" in said
        assert "interrupted" not in said
        assert run(["resume", "--port", fast.port]) == 3
        assert "a plot is running" in capsys.readouterr().err
        state = load(journal_path())
        assert state is not None
        assert (state.head["file"], state.parts) == (str(drawing), 1)
        process.kill()
        process.communicate(timeout=30)
    with journal_lock(journal_path()) as ours:
        assert ours, "a killed plot's lock has gone with it"


def test_a_board_that_is_not_there_is_named(
    drawing: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As with the cable out; a simulation would be no way to go on."""
    with start_virtual_board(nickname="East", speed=20, patience_s=0.2) as board:
        interrupted(drawing, board)
        port = board.port
    monkeypatch.setattr("plotter.cli.resume._BACK_TIMEOUT_S", 0.1)
    monkeypatch.setattr("plotter.cli.resume.find_ports", list)
    assert run(["resume"]) == 4
    said = capsys.readouterr().err
    assert "'East'" in said
    assert port in said
    assert "sim" not in said
