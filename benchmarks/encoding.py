"""Encoding and verifying a million pieces: seconds and memory, with nothing merged so that all of them are commands."""

from __future__ import annotations

import resource
import time
from itertools import chain

import numpy as np

from output.ebb.encode import BoardSetup, PenCommands, Sizing, encode, prologue
from output.ebb.firmware import firmware
from output.ebb.verify import Report, verify
from planning.motion.limits import Kinematics
from planning.motion.plan import Draw, Motion

PIECES = 1_000_000


def walk(pieces: int, ticks: int = 250) -> Motion:
    """A smooth random walk: the uniform cubic B-spline over random control points, rest to rest."""
    rng = np.random.default_rng(1)
    heading = np.cumsum(rng.normal(0.0, 0.4, pieces - 2))
    step_mm = rng.random(pieces - 2)
    points = np.cumsum(step_mm[:, None] * np.column_stack((np.cos(heading), np.sin(heading))), axis=0)
    c = np.vstack((points[:1], points[:1], points, points[-1:], points[-1:]))
    c -= c[0]  # from where the board's counters are 0
    h = ticks * 40e-6
    acceleration = (c[:-2] - 2 * c[1:-1] + c[2:]) / h**2
    position = (c[:-2] + 4 * c[1:-1] + c[2:]) / 6
    velocity = (c[2:] - c[:-2]) / (2 * h)
    jerk = np.diff(acceleration, axis=0) / h
    return Motion(np.full(len(jerk), h), position[:-1], velocity[:-1], acceleration[:-1], jerk, position[-1])


def run() -> None:
    """Print the figures."""
    kinematics = Kinematics(np.array([[80.0, 80.0], [80.0, -80.0]]), 25000.0)
    motion = walk(PIECES)
    for text, merge_steps in (("every piece a command", 0.0), ("merged as usual", Sizing().merge_steps)):
        setup = BoardSetup(kinematics, firmware(), PenCommands(16000, 24000, 400, 400), sizing=Sizing(merge_steps=merge_steps))
        started, started_cpu = time.perf_counter(), time.process_time()
        report = verify(chain(prologue(setup), encode([Draw(motion, 0)], setup)), firmware(), kinematics)
        took, cpu = time.perf_counter() - started, time.process_time() - started_cpu
        off_steps = _drift_steps(motion, kinematics, report)
        peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(
            f"{len(motion)} pieces encoded and checked, {text}: {report.commands} commands, {took:.1f} s ({cpu:.1f} s of CPU), "
            f"peak {peak_mb:.0f} MB, {report.duration_s:.0f} s of plotting, ends {off_steps} steps off"
        )


def _drift_steps(motion: Motion, kinematics: Kinematics, report: Report) -> int:
    """How far the counters end from the rounded end of the plan, which begins at 0."""
    end = np.rint(kinematics.steps(motion.end_mm[None, :]))[0].astype(np.int64)
    return int(np.abs(np.array(report.final_steps) - end).max())


if __name__ == "__main__":
    run()
