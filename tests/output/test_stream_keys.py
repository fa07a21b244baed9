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
