"""Ctrl-C while the program is still being loaded: one sentence and code 130, whatever is being imported."""

from __future__ import annotations

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
