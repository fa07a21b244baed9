"""Ctrl-C while the program is still being loaded: one sentence and code 130, whatever is being imported."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

SAMPLE = Path(__file__).parents[2] / "samples" / "shapes.svg"
# Presses Ctrl-C in the middle of an import, where Python would make an exception of it.
PROGRAM = """
import builtins, os, signal, sys
real, wanted = builtins.__import__, sys.argv[1]
def imported(name, *arguments, **named):
    if name == wanted:
        os.kill(os.getpid(), signal.SIGINT)
    return real(name, *arguments, **named)
from plotter.cli.start import main
builtins.__import__ = imported
main(sys.argv[2:])
"""


@pytest.mark.parametrize("module", ["click", "numpy", "ruckig", "plotter.settings", "lxml"])
def test_while_it_is_loaded(module: str) -> None:
    command = [sys.executable, "-c", PROGRAM, module, "preview", str(SAMPLE)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "plotter: interrupted\n")


def test_ignored_it_stays_ignored() -> None:
    """As for what a script starts with `&`."""
    program = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)\n" + PROGRAM
    command = [sys.executable, "-c", program, "click", "preview", str(SAMPLE)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 0
    assert "pen down" in ended.stdout


def test_lost_in_a_destructor_it_is_no_plot(tmp_path: Path) -> None:
    """Python prints what is raised there, and goes on."""
    lost = """
import os, signal, sys
from plotter.cli import plot, start
class Dying:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        sum(range(1000))
prepare = plot.prepare
def with_a_death(*arguments):
    dying = Dying()
    del dying
    return prepare(*arguments)
plot.prepare = with_a_death
start.main(sys.argv[1:])
"""
    record = tmp_path / "record.json"
    command = [sys.executable, "-c", lost, "plot", str(SAMPLE), "--port", "sim", "--speed", "100", "--record", str(record)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 130, ended.stderr
    assert ended.stderr.endswith("plotter: interrupted\n")
    assert not [ink for ink in json.loads(record.read_text())["ink"] if len(ink["points"]) > 1]
