"""How fast drawings are read, and in how much memory: each in a process of its own, CPU seconds from file to polylines."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

HEAD = '<svg xmlns="http://www.w3.org/2000/svg" width="210mm" height="297mm" viewBox="0 0 210 297">'

CHILD = """
import resource, sys, time
from pathlib import Path
from plotter.svg.read import read_drawing
begin = time.process_time()
drawing = read_drawing(Path(sys.argv[1]))
spent = time.process_time() - begin
status = Path("/proc/self/status")
if status.exists():
    peak_mb = int(status.read_text().split("VmHWM:")[1].split()[0]) / 1024
else:
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
points = sum(len(stroke.points_mm) for layer in drawing.layers for stroke in layer.strokes)
print(spent, peak_mb, drawing.stroke_count, points)
"""


def cubics(count: int, per_path: int) -> str:
    """`count` absolute cubics wandering over the page, `per_path` in each path."""
    random = np.random.default_rng(1)
    parts = [HEAD, '<g fill="none" stroke="black">']
    for _ in range(count // per_path):
        walk = np.cumsum(random.normal(0, 0.5, (3 * per_path + 1, 2)), axis=0) + random.uniform(0, 200, 2)
        rows = walk[1:].reshape(-1, 6).tolist()
        parts.append("<path d='M{:.3f},{:.3f}".format(*walk[0]))
        parts += ["C{:.3f},{:.3f} {:.3f},{:.3f} {:.3f},{:.3f}".format(*row) for row in rows]
        parts.append("'/>")
    return "".join([*parts, "</g></svg>"])


def relative_cubics(count: int) -> str:
    """One path of `count` relative cubics."""
    rows = np.random.default_rng(2).normal(0, 0.5, (count, 6)).tolist()
    body = "".join("c{:.3f},{:.3f} {:.3f},{:.3f} {:.3f},{:.3f}".format(*row) for row in rows)
    return f"{HEAD}<path fill='none' stroke='black' d='M100 100{body}'/></svg>"


def styled(count: int) -> str:
    """Small shapes of four kinds, styled by classes, style attributes, presentation attributes and a descendant selector."""
    sheet = "<style>.a{fill:none;stroke:red}.b{stroke:#123456;fill:none}g .c{stroke:blue;fill:none}</style><g>"
    parts = [HEAD, sheet]
    for i, (x, y, u, v, w, z) in enumerate(np.random.default_rng(3).uniform(0, 9, (count, 6)).round(3).tolist()):
        parts.append(
            (
                f'<path class="a" d="M{x} {y}l{u} {v} {w} {z}z"/>',
                f'<circle class="b" cx="{x}" cy="{y}" r="{u}" style="stroke-width:{1 + i % 17}"/>',
                f'<rect style="fill:none;stroke:#{i:06x}" x="{x}" y="{y}" width="{u}" height="{v}" transform="rotate({w})"/>',
                f'<line class="c" x1="{x}" y1="{y}" x2="{u}" y2="{v}"/>',
            )[i % 4]
        )
    return "".join([*parts, "</g></svg>"])


# What is read, how to make it, and what it may cost: CPU seconds and MB (None: no bound was set).
CASES: list[tuple[str, Callable[[], str], float, float | None]] = [
    ("100,000 cubics in 1,000 paths", lambda: cubics(100_000, 100), 1.0, 200),
    ("1,000,000 cubics in 10,000 paths", lambda: cubics(1_000_000, 100), 8.0, 700),
    ("1,000,000 cubics in one path, relative", lambda: relative_cubics(1_000_000), 8.0, 700),
    ("330,000 small styled elements", lambda: styled(330_000), 25.0, None),
]


def run() -> None:
    """Print the table of speeds."""
    table = Table(title="Reading, from file to polylines")
    for column in ("drawing", "file MB", "CPU s", "at most", "peak MB", "at most", "strokes", "points"):
        table.add_column(column, justify="left" if column == "drawing" else "right")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "drawing.svg"
        for name, make, most_s, most_mb in CASES:
            file.write_text(make())
            child = subprocess.run([sys.executable, "-c", CHILD, str(file)], capture_output=True, text=True, check=True)
            spent_s, peak_mb, strokes, points = map(float, child.stdout.split())
            table.add_row(
                name,
                f"{file.stat().st_size / 1e6:.1f}",
                f"{spent_s:.2f}",
                f"{most_s:g}",
                f"{peak_mb:.0f}",
                "" if most_mb is None else f"{most_mb:g}",
                f"{strokes:.0f}",
                f"{points:.0f}",
            )
    Console(width=120).print(table)


if __name__ == "__main__":
    run()
