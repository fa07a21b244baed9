"""Six drawings on five firmware generations: what is sent, how long it takes, how exact and how smooth it is."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from output.ebb.commands import Command
from output.ebb.encode import encode, epilogue, prologue
from output.ebb.firmware import firmware
from output.ebb.verify import compare, verify
from planning.motion.plan import Action, Draw
from plotter.board_setup import board_setup
from plotter.pipeline import planned, prepare
from plotter.settings import resolve
from plotter.svg.options import ReadOptions

DRAWINGS = ("rosette", "letter", "shapes", "tree", "hilbert", "arcs")
VERSIONS = ("3.0.3", "3.0.0", "2.8.1", "2.6.6", "1.9.5")
SAMPLES = Path(__file__).parents[1] / "samples"


def run() -> None:
    """Print the table. Deviation is of what is drawn from the plan's own curve, both ways, in steps of 1/80 mm."""
    print("| drawing | firmware | commands | bytes | duration s | deviation steps | velocity jump mm/s | lead ms | slowed s |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    settings = resolve({}).values
    for name in DRAWINGS:
        job = prepare(str(SAMPLES / f"{name}.svg"), ReadOptions(), settings)
        actions = list(planned(job))
        curves = [_curve(a) for a in actions if isinstance(a, Draw)]
        for version in VERSIONS:
            setup = dataclasses.replace(board_setup(settings, job.machine), firmware=firmware(version))
            program = [*prologue(setup), *encode(actions, setup), *epilogue(setup)]
            report = verify(program, setup.firmware, setup.kinematics)
            apart = compare(report.strokes, curves, 0.005)
            steps = max(apart.drawn.max_mm, apart.wanted.max_mm) * 80
            sent = sum(len(item.wire()) + 1 for item in program if isinstance(item, Command))
            lead = f"{report.lowest_lead_s * 1000:.0f}" if report.lowest_lead_s is not None else "-"
            print(
                f"| {name} | {version} | {report.commands} | {sent} | {report.duration_s:.1f} | {steps:.2f} | "
                f"{report.max_velocity_jump_mm_s:.2f} | {lead} | {report.slowed_s:.1f} |",
                flush=True,
            )
            for problem in report.problems:
                print(f"  {name} {version}: {problem}")


def _curve(action: Action) -> np.ndarray:
    assert isinstance(action, Draw)
    count = max(int(action.motion.total_s / 4e-4), 2)
    return action.motion.sample(np.linspace(0.0, action.motion.total_s, count))[0]


if __name__ == "__main__":
    run()
