"""Every sample, promised by preview and plotted on the virtual board: time, ink, planning. Takes some minutes."""

from __future__ import annotations

import contextlib
import io
import json
import resource
import tempfile
import time
from pathlib import Path

from output.ebb.verify_compare import compare
from plotter.cli.main import run as plotter
from plotter.cli.plot import ink_mm
from plotter.machines.profile import load_machine
from plotter.svg.read import read_drawing

SAMPLES = sorted((Path(__file__).parents[1] / "samples").glob("*.svg"))
FIRST_LIFT_S = 0.5  # the set-up's own pen-up, before anything moves


def run() -> None:
    print(
        "| sample | strokes | pen down m | promised s | board s | off % | ink off mm | drawing off mm | preview CPU s | CPU % |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    kinematics = load_machine("axidraw-v3").kinematics()
    for sample in SAMPLES:
        began = time.process_time()
        promised = json.loads(_said(["preview", str(sample), "--json"]))
        cpu_s = time.process_time() - began
        with tempfile.TemporaryDirectory() as folder:
            record_file = Path(folder) / "record.json"
            _said(["plot", str(sample), "--port", "sim", "--speed", "200", "--record", str(record_file)])
            record = json.loads(record_file.read_text())
        took_s = record["motion_ticks"] / record["ticks_per_s"] + FIRST_LIFT_S
        wanted = [stroke.points_mm for layer in read_drawing(sample).layers for stroke in layer.strokes]
        off = compare(ink_mm(record, kinematics), wanted)
        print(
            f"| {sample.stem} | {promised['strokes']} | {promised['pen_down_mm'] / 1000:.2f} | {promised['duration_s']:.1f}"
            f" | {took_s:.1f} | {100 * (took_s / promised['duration_s'] - 1):+.2f} | {off.drawn.max_mm:.4f}"
            f" | {off.wanted.max_mm:.4f} | {cpu_s:.1f} | {100 * cpu_s / promised['duration_s']:.2f} |",
            flush=True,
        )
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


def _said(arguments: list[str]) -> str:
    """What the program printed; a failure ends the benchmark."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        code = plotter(arguments)
    if code:
        raise SystemExit(f"plotter {' '.join(arguments)} ended with {code}")
    return out.getvalue()
