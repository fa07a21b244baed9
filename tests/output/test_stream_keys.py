"""Keys and signals end in the same flag."""

from __future__ import annotations

import os
import pty
import signal
import time

import pytest

from output.ebb.control import StopFlag, signals_stop
from plotter.cli import keys as module
from plotter.cli.keys import keys, press


def test_p_pauses_and_goes_on_and_q_stops() -> None:
    stop = StopFlag()
    press("p", stop)
    assert stop.pause_reason is not None
    press(" ", stop)
    assert stop.pause_reason is None
    press("h", stop)
    assert stop.pause_reason is not None
    assert stop.home_asked
    assert stop.leave_asked
    press("x", stop)
    assert not stop.requested
    press("q", stop)
    assert stop.reason == "stopped by key"


def test_keys_of_a_terminal_reach_the_flag_and_its_mode_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    master, slave = pty.openpty()
    stop = StopFlag()
    with os.fdopen(slave, "r") as terminal:
        monkeypatch.setattr(module.sys, "stdin", terminal)
        assert module.termios is not None
        before = module.termios.tcgetattr(slave)
        with keys(stop) as listening:
            assert listening
            assert module.termios.tcgetattr(slave) != before
            os.write(master, b"p")
            end = time.monotonic() + 3
            while stop.pause_reason is None and time.monotonic() < end:
                time.sleep(0.01)
            assert stop.pause_reason is not None
        assert module.termios.tcgetattr(slave) == before
    os.close(master)


@pytest.mark.parametrize(
    "typed",
    [
        [b"\x1bOQ"],  # F2
        [b"\x1bOP"],  # F1
        [b"\x1b[H"],  # Home
        [b"\x1b[1;5P", b"\x1b[15~", b"\x1b[A"],  # Ctrl-F1, F5, up
        [b"\x1b[[A"],  # F1 of a Linux console
        [b"\x1bq"],  # Alt-q
        [b"\x1b\x1b[H"],  # Alt-Home
        [b"\x1b", b"[", b"1;2", b"H"],  # Shift-Home, come in pieces
        [b"x" * 62 + b"\x1bOQ"],  # across what is read at once
    ],
)
def test_function_and_cursor_keys_are_no_letters(typed: list[bytes], monkeypatch: pytest.MonkeyPatch) -> None:
    stop = StopFlag()
    keys_are_typed(typed, stop, monkeypatch)
    assert (stop.pause_reason, stop.reason, stop.home_asked) == (None, None, False)


def test_after_an_escape_a_letter_is_a_letter_again(monkeypatch: pytest.MonkeyPatch) -> None:
    stop = StopFlag()
    keys_are_typed([b"\x1bOP" + b"p"], stop, monkeypatch)
    assert stop.pause_reason == "paused by key"
    keys_are_typed([b"\x1b"], stop, monkeypatch)
    keys_are_typed([b"q"], stop, monkeypatch)
    assert stop.reason == "stopped by key"


def keys_are_typed(typed: list[bytes], stop: StopFlag, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each a moment after the one before, and whatever they mean is done."""
    master, slave = pty.openpty()
    with os.fdopen(slave, "r") as terminal:
        monkeypatch.setattr(module.sys, "stdin", terminal)
        with keys(stop):
            for piece in typed:
                os.write(master, piece)
                time.sleep(0.02)
            time.sleep(0.25)
    os.close(master)


def test_without_a_terminal_there_are_no_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    read_end, write_end = os.pipe()
    with os.fdopen(read_end) as pipe:
        monkeypatch.setattr(module.sys, "stdin", pipe)
        with keys(StopFlag()) as listening:
            assert not listening
    os.close(write_end)


def test_signals_only_set_the_flag_and_wake() -> None:
    stop, woken = StopFlag(), []
    before = signal.getsignal(signal.SIGINT)
    with signals_stop(stop), stop.waking(lambda: woken.append(1)):
        os.kill(os.getpid(), signal.SIGINT)
        assert stop.reason == "stopped by Ctrl-C"
        assert stop.signal_number == signal.SIGINT
        assert not stop.hurry
        os.kill(os.getpid(), signal.SIGTERM)
        assert stop.hurry
        assert stop.signal_number == signal.SIGINT
    assert len(woken) == 2
    assert signal.getsignal(signal.SIGINT) is before


def test_where_a_pause_is_possible_the_first_ctrl_c_pauses_and_the_second_stops() -> None:
    stop = StopFlag()
    with signals_stop(stop, pauses=True):
        os.kill(os.getpid(), signal.SIGINT)
        assert stop.pause_reason == "paused by Ctrl-C"
        assert stop.pause_signal == signal.SIGINT
        assert not stop.requested
        os.kill(os.getpid(), signal.SIGINT)
        assert stop.reason == "stopped by Ctrl-C"
    for number in (signal.SIGTERM, signal.SIGHUP):
        stop = StopFlag()
        with signals_stop(stop, pauses=True):
            os.kill(os.getpid(), number)
            assert stop.requested
