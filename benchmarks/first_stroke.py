"""From the command to the first motion and the first line, on the virtual board: samples, and large drawings made here.

The virtual board runs at real time on a port of its own. CPU seconds are those of the whole command up to the first motion;
they say more than the clock on a machine that does other things as well.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from output.ebb.virtual.process import VirtualBoard, start_virtual_board
from planning.geometry.stroke import Points

SAMPLES = sorted((Path(__file__).parents[1] / "samples").glob("*.svg"))
_DEADLINE_S = 120.0
_LOOK_EVERY_S = 0.02
_PROGRAM = "import sys; from plotter.cli.main import main; main(sys.argv[1:])"


def run(extra: tuple[str, ...] = ()) -> None:
    print("| drawing | MB | first motion s | first line s | CPU s until then |")
    print("|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name, file in (*((sample.stem, sample) for sample in SAMPLES), *large(Path(folder))):
            motion_s, line_s, cpu_s = first_stroke(file, extra)
            print(f"| {name} | {file.stat().st_size / 1e6:.1f} | {motion_s:.2f} | {line_s:.2f} | {cpu_s:.2f} |", flush=True)


def first_stroke(file: Path, extra: tuple[str, ...] = ()) -> tuple[float, float, float]:
    """Seconds from starting `plotter plot` to the first step of a motor, and to the first line, and its CPU time until then."""
    with tempfile.TemporaryDirectory() as state, start_virtual_board(keep_wire=False) as board:
        began_s, began_tick = time.monotonic(), board.state()["now_tick"]
        environment = {**os.environ, "XDG_STATE_HOME": state, "XDG_CONFIG_HOME": state}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)  # what is installed is compiled
        command = [sys.executable, "-c", _PROGRAM, "plot", str(file), "--port", board.port, *extra]
        process = subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        try:
            cpu_s = _wait_for_motion(board, process, began_s)
            record = board.record()
            while not any(len(ink["points"]) > 1 for ink in record["ink"]) and time.monotonic() - began_s < _DEADLINE_S:
                time.sleep(_LOOK_EVERY_S)
                record = board.record()
        finally:
            process.kill()
            process.wait()
        per_s = record["ticks_per_s"]
        line_tick = next((ink["ticks"][1] for ink in record["ink"] if len(ink["points"]) > 1), np.nan)
        return (record["first_motion_tick"] - began_tick) / per_s, (line_tick - began_tick) / per_s, cpu_s


def _wait_for_motion(board: VirtualBoard, process: subprocess.Popen[bytes], began_s: float) -> float:
    while board.state()["position"] == [0, 0]:
        if process.poll() is not None or time.monotonic() - began_s > _DEADLINE_S:
            raise SystemExit(f"nothing moved within {time.monotonic() - began_s:.0f} s (exit code {process.poll()})")
        time.sleep(_LOOK_EVERY_S)
    user, system = Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def large(folder: Path) -> Iterator[tuple[str, Path]]:
    """Generated drawings, as large as people bring; each is written when it is asked for."""
    rng = np.random.default_rng(1)
    for count in (1_000, 10_000, 100_000, 300_000):
        begin = rng.uniform((5, 5), (275, 195), (count, 2))
        end = np.clip(begin + rng.normal(0, 2, (count, 2)), 0.5, 199)
        yield (
            f"{count:,} paths of one line",
            _written(folder / f"{count}.svg", (f'<path d="{d}"/>' for d in _moves(begin, end))),
        )
        if count == 100_000:
            yield from _kinds(folder, begin, end, rng)
    turn = np.linspace(0, 1, 100_000)
    spiral = (140 + 90j + 10 + (2 + 85 * turn) * np.exp(2j * np.pi * 300 * turn)).tolist()
    yield "a stroke of 100,000 vertices", _written(folder / "vertices.svg", [_polyline((z.real, z.imag) for z in spiral)])
    walks = (rng.uniform((60, 60), (220, 140)) + np.cumsum(rng.normal(0, 0.5, (600, 2)), axis=0) for _ in range(2000))
    yield "20 MB, 1,200,000 vertices", _written(folder / "20mb.svg", (_polyline(np.clip(w, 1, 199)) for w in walks))


def _kinds(folder: Path, begin: Points, end: Points, rng: np.random.Generator) -> Iterator[tuple[str, Path]]:
    """As many strokes as there are rows in `begin` and `end` (n, 2), written in the other ways in which programs write them."""
    count = len(begin)
    ends = np.hstack((begin, end)).tolist()
    lines = (f'<line x1="{a:.2f}" y1="{b:.2f}" x2="{c:.2f}" y2="{d:.2f}"/>' for a, b, c, d in ends)
    yield f"{count:,} lines", _written(folder / "lines.svg", lines)
    yield f"one path of {count:,} subpaths", _written(folder / "subpaths.svg", [f'<path d="{"".join(_moves(begin, end))}"/>'])
    sizes = rng.uniform(0.2, 1, count).tolist()
    circles = (f'<circle cx="{x:.2f}" cy="{y:.2f}" r="{r:.2f}"/>' for (x, y), r in zip(begin.tolist(), sizes, strict=True))
    yield f"{count:,} circles", _written(folder / "circles.svg", circles)
    walks = (np.clip(at + np.cumsum(rng.normal(0, 0.4, (10, 2)), axis=0), 1, 199) for at in begin)
    yield f"{count:,} polylines of 10 points", _written(folder / "polylines.svg", (_polyline(walk, 2) for walk in walks))


def _moves(begin: Points, end: Points) -> Iterator[str]:
    return (f"M{a:.2f} {b:.2f}L{c:.2f} {d:.2f}" for a, b, c, d in np.hstack((begin, end)).tolist())


def _polyline(points: Iterable[tuple[float, float]] | Points, digits: int = 5) -> str:
    return '<polyline points="' + " ".join(f"{x:.{digits}f},{y:.{digits}f}" for x, y in points) + '"/>'


def _written(file: Path, shapes: Iterable[str]) -> Path:
    head = (
        '<svg xmlns="http://www.w3.org/2000/svg" width="280mm" height="200mm" viewBox="0 0 280 200" fill="none" stroke="black">'
    )
    file.write_text("\n".join([head, *shapes, "</svg>"]))
    return file
