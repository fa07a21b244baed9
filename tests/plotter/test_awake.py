"""Sleep is held off while a plot runs, and only then; without the means nothing fails."""

from __future__ import annotations

import os
import stat
import time
from pathlib import Path

import pytest

from plotter.cli.awake import awake


def test_the_holder_runs_for_as_long_as_the_context(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program, trace = tmp_path / "systemd-inhibit", tmp_path / "trace"
    program.write_text(f"#!/bin/sh\necho $$ $@ > {trace}.new\nmv {trace}.new {trace}\nexec sleep 60\n")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setattr("sys.platform", "linux")
    with awake():
        deadline = time.monotonic() + 5
        while not trace.exists() and time.monotonic() < deadline:
            time.sleep(0.01)
        pid, *words = trace.read_text().split()
        assert "--what=sleep:idle" in words
        os.kill(int(pid), 0)
    with pytest.raises(ProcessLookupError):
        os.kill(int(pid), 0)


def test_without_the_means_nothing_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr("sys.platform", "linux")
    with awake():
        pass
