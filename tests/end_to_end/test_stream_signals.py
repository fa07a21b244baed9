"""Signals, crashes and pulled cables on a real port, against the virtual board in a process of its own."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from output.ebb.commands import SM
from output.ebb.firmware import firmware
from output.ebb.journal import load
from output.ebb.resume import find_place, position_lost
from output.ebb.session import connect
from output.ebb.virtual.process import VirtualBoard, start_virtual_board
from output.errors import LinkLost
from tests.end_to_end.stream_runner import MOVES, STROKES, program
from tests.output.test_stream_loops import check_ink_within_plan, check_plan_is_inked

ITEMS = list(program())


@contextmanager
def plotting(board: VirtualBoard, journal: Path, speed: float = 1.0, **streams: Any) -> Iterator[subprocess.Popen[bytes]]:
    command = [sys.executable, "-m", "tests.end_to_end.stream_runner", board.port, str(speed), str(journal)]
    streams.setdefault("stdout", subprocess.PIPE)
    process = subprocess.Popen(command, stderr=subprocess.PIPE, **streams)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
        for stream in (process.stdout, process.stderr):
            if stream is not None:
                stream.close()


def wait_for_motion(process: subprocess.Popen[bytes]) -> None:
    assert process.stdout is not None
    assert process.stdout.readline() == b"streaming\n"


def outcome(process: subprocess.Popen[bytes], timeout_s: float = 20.0) -> tuple[int, dict[str, Any]]:
    out, err = process.communicate(timeout=timeout_s)
    assert b"Traceback" not in err, err.decode()
    lines = out.decode().splitlines()
    return process.returncode, json.loads(lines[-1]) if lines else {}


def check_board(board: VirtualBoard) -> dict[str, Any]:
    record = board.record()
    assert record["pen_up"]
    assert record["idle"]
    assert record["queued"] == 0
    assert record["parser_blocked"] == []
    check_ink_within_plan(record["ink"], ITEMS)
    return record


def test_a_whole_plot_on_a_real_port(tmp_path: Path) -> None:
    with start_virtual_board(speed=4) as board:
        with plotting(board, tmp_path / "j", 4) as process:
            code, said = outcome(process)
        assert (code, said["outcome"]) == (0, "done")
        record = check_board(board)
        check_plan_is_inked(record["ink"], ITEMS)
        assert record["underruns"] == 0
        assert record["stepper_moves"] == STROKES * (MOVES + 1)


def interrupt(tmp_path: Path, delay_s: float, numbers: list[int], between_s: float = 0.0) -> dict[str, Any]:
    with start_virtual_board() as board, plotting(board, tmp_path / "j") as process:
        wait_for_motion(process)
        time.sleep(delay_s)
        for number in numbers:
            process.send_signal(number)
            time.sleep(between_s)
        code, said = outcome(process)
        record = check_board(board)
        assert code == 130
        assert said["stop"]["pen_up"]
        assert record["motors_on"] == [False, False]
        state = load(tmp_path / "j")
        assert state is not None
        assert state.ended == "stopped"
        return said


@pytest.mark.parametrize(
    "number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR1, signal.SIGUSR2, signal.SIGALRM]
)
def test_each_signal_raises_the_pen_and_stops_the_motors(number: int, tmp_path: Path) -> None:
    said = interrupt(tmp_path, 0.4, [number])
    assert said["reason"] == f"stopped by {'Ctrl-C' if number == signal.SIGINT else signal.Signals(number).name}"
    assert said["stop"]["took_s"] < 0.5


@pytest.mark.parametrize("between_s", [0.0, 0.02])
def test_a_second_ctrl_c_does_not_keep_the_pen_down(between_s: float, tmp_path: Path) -> None:
    interrupt(tmp_path, 0.5, [signal.SIGINT, signal.SIGINT, signal.SIGINT], between_s)


@pytest.mark.long
def test_ctrl_c_at_two_hundred_random_instants(tmp_path: Path) -> None:
    rng, took = random.Random(11), []
    for _ in range(200):
        said = interrupt(tmp_path, rng.uniform(0.0, 2.0), [signal.SIGINT])
        took.append(said["stop"]["took_s"])
    took.sort()
    print(f"stop latency over a port: median {took[100] * 1000:.1f} ms, worst {took[-1] * 1000:.1f} ms")


def test_a_closed_output_does_not_end_the_plot(tmp_path: Path) -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    with start_virtual_board(speed=4) as board, plotting(board, tmp_path / "j", 4, stdout=write_end) as process:
        os.close(write_end)
        process.wait(20)
        check_plan_is_inked(board.record()["ink"], ITEMS)


def kill_and_look(tmp_path: Path, delay_s: float) -> None:
    """SIGKILL: nothing can raise the pen, but the damage is bounded, the journal loads and the place is found."""
    journal = tmp_path / "j"
    with start_virtual_board() as board:
        with plotting(board, journal) as process:
            wait_for_motion(process)
            time.sleep(delay_s)
            before = board.state()["queued"]
            process.kill()
            process.wait()
        assert before <= 32
        deadline = time.monotonic() + 3.0
        while not board.state()["idle"]:
            assert time.monotonic() < deadline, "more than about a second of motion was on the board"
            time.sleep(0.05)
        state = load(journal)
        assert state is not None
        assert state.interrupted
        with connect(board.port, clear=False) as again:
            if not any(board.state()["motors_on"]):
                # Killed before the motors were switched on: nothing is drawn, and where the carriage is nobody knows.
                assert board.record()["stepper_moves"] == 0
                assert "motors" in str(position_lost(again, state))
                return
            assert position_lost(again, state) is None
            steps = again.steps()
            again.clear()
            place = find_place(program(), firmware(again.firmware), state, steps)
        assert place is not None
        assert place.steps == steps
        record = board.record()
        moves = sum(isinstance(item, SM) for item in list(commands())[: place.command])
        assert moves == record["stepper_moves"], "the place is after the last move that the board made"
        check_board(board)


def commands() -> Iterator[object]:
    return (item for item in ITEMS if hasattr(item, "wire"))


@pytest.mark.parametrize("delay_s", [0.1, 0.7, 1.4])
def test_a_killed_plot_can_be_found_again(delay_s: float, tmp_path: Path) -> None:
    kill_and_look(tmp_path, delay_s)


@pytest.mark.long
def test_kills_at_two_hundred_random_instants(tmp_path: Path) -> None:
    rng = random.Random(5)
    for _ in range(200):
        kill_and_look(tmp_path, rng.uniform(0.0, 1.9))


@pytest.mark.parametrize("stroke", [1, 4])
def test_a_pulled_cable_is_told_within_a_second(stroke: int, tmp_path: Path) -> None:
    with start_virtual_board(speed=4, faults=[{"fault": "hangup", "at": {"stroke": stroke}}]) as board:
        with plotting(board, tmp_path / "j", 4) as process:
            wait_for_motion(process)
            began = time.monotonic()
            code, said = outcome(process)
        assert code == 4
        assert "may be down" in said["error"]
        assert time.monotonic() - began < 5.0
        state = load(tmp_path / "j")
        assert state is not None
        assert state.interrupted
        assert state.ended is not None
        assert "LinkLost" in state.ended


def test_a_restarted_board_is_not_drawn_on(tmp_path: Path) -> None:
    faults = [{"fault": "reboot", "at": {"stroke": 2}, "hangup": False}]
    with start_virtual_board(speed=2, faults=faults) as board:
        with plotting(board, tmp_path / "j", 2) as process:
            code, said = outcome(process)
        assert code == 3
        assert "restarted" in said["error"]
        time.sleep(0.3)
        assert board.state()["pen_up"]
        assert board.state()["idle"]


def test_a_host_that_is_stopped_for_a_while(tmp_path: Path) -> None:
    """SIGSTOP and SIGCONT: what came meanwhile is in time, the queue covers what it can, and nothing is lost."""
    with start_virtual_board() as board, plotting(board, tmp_path / "j") as process:
        wait_for_motion(process)
        for _ in range(3):
            time.sleep(0.3)
            process.send_signal(signal.SIGSTOP)
            time.sleep(0.5)
            process.send_signal(signal.SIGCONT)
        code, said = outcome(process)
        assert code == 0, said
        record = check_board(board)
        check_plan_is_inked(record["ink"], ITEMS)
        assert record["underruns"] == 0


def test_a_stopped_host_past_every_deadline(tmp_path: Path) -> None:
    with start_virtual_board() as board, plotting(board, tmp_path / "j") as process:
        wait_for_motion(process)
        process.send_signal(signal.SIGSTOP)
        time.sleep(2.5)
        process.send_signal(signal.SIGCONT)
        code, said = outcome(process)
        assert code == 0, said
        check_plan_is_inked(check_board(board)["ink"], ITEMS)


def test_two_programs_cannot_have_one_board(tmp_path: Path) -> None:
    with start_virtual_board(speed=2) as board, plotting(board, tmp_path / "a", 2) as first:
        wait_for_motion(first)
        first.send_signal(signal.SIGSTOP)  # so that it is not over before the second one has begun
        try:
            with plotting(board, tmp_path / "b", 2) as second:
                code, said = outcome(second)
        finally:
            first.send_signal(signal.SIGCONT)
        assert code == 3
        assert f"process {first.pid}" in said["error"]
        code, _ = outcome(first)
        assert code == 0
        check_plan_is_inked(check_board(board)["ink"], ITEMS)


def test_a_board_that_returns_under_another_name_starts_empty(tmp_path: Path) -> None:
    link = tmp_path / "ebb"
    with start_virtual_board(pty=link) as board:
        with connect(str(link)) as first:
            first.send(SM(3000, 500, 500))
            board.control("hangup 0.2")
            with pytest.raises(LinkLost):
                for _ in range(100):
                    first.query("QS")
                    time.sleep(0.02)
        time.sleep(0.5)
        with connect(str(link)) as again:
            assert again.firmware == "3.0.3"
            assert board.state()["idle"]
            assert board.state()["pen_up"]
            where = again.steps()
            time.sleep(0.5)
            assert again.steps() == where
