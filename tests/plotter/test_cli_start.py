"""What is loaded before the first stroke: time in which nothing moves."""

from __future__ import annotations

import subprocess
import sys

import pytest

# Each takes 20 to 300 ms. Pictures, bars and some texts need one, or nothing does; for scipy see planning/motion/late.py.
NOT_TO_PLOT = ("scipy", "rich", "PIL", "svgpathtools", "wasmtime", "HersheyFonts")
NOT_TO_START = (*NOT_TO_PLOT, "numpy", "shapely", "pydantic", "lxml", "ruckig", "serial")


@pytest.mark.parametrize(
    ("module", "heavy"),
    [("plotter.cli.main", NOT_TO_START), ("plotter.cli.plot", NOT_TO_PLOT), ("plotter.cli.resume", NOT_TO_PLOT)],
)
def test_what_is_not_needed_is_not_loaded(module: str, heavy: tuple[str, ...]) -> None:
    look = f"import sys, {module}; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True).stdout.split()
    assert module in loaded
    assert sorted(set(heavy) & set(loaded)) == []
