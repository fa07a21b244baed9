"""A resumed part's program, executed by the firmware's arithmetic: its strokes end on the steps that it says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from output.ebb import arithmetic, arithmetic_old
from output.ebb.arithmetic import State
from output.ebb.commands import CS, EM, Command, MotionCommand
from output.ebb.program import StrokeEnd
from planning.motion import draw
from planning.motion.plan import Draw
from plotter.board_setup import board_setup
from plotter.journals import Part, part_program
from plotter.pipeline import planned, prepare
from plotter.settings import resolve
from plotter.svg.options import ReadOptions

DRAWING = """<svg xmlns="http://www.w3.org/2000/svg" width="60mm" height="60mm" viewBox="0 0 60 60" fill="none" stroke="black">
  <path d="M10.03 10.01L50.02 12.07"/><circle cx="30.011" cy="30.007" r="8.013"/>
  <path d="M12.3 50.1C20 40 40 60 48.7 50.2"/></svg>"""


@pytest.mark.parametrize("homed", [False, True])
@pytest.mark.parametrize("firmware", ["3.0.3", "3.0.0", "2.8.1", "2.6.6"])
@pytest.mark.parametrize("acc", [(0, 0), (2_000_000_000, 7), (123_456_789, 2_147_483_647)])
def test_a_resumed_part_ends_its_strokes_on_their_steps(
    acc: tuple[int, int], firmware: str, homed: bool, tmp_path: Path
) -> None:
    check_ends(acc, firmware, homed, tmp_path)


@pytest.mark.parametrize("firmware", ["3.0.3", "2.8.1", "2.6.6"])
def test_so_does_one_whose_strokes_come_in_parts(firmware: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = {"LONG_S": 0.2, "WINDOW_VERTICES": 60, "WINDOW_S": 3.0, "LEAST_PART_S": 0.0}
    for name, value in small.items():
        monkeypatch.setattr(draw, name, value)
    parts = check_ends((123_456_789, 7), firmware, False, tmp_path, draw_speed=15.0)
    assert parts > 6


def check_ends(acc: tuple[int, int], firmware: str, homed: bool, tmp_path: Path, **more: object) -> int:
    """Checks that every stroke ends on its steps, and so does the plot; in how many parts the strokes were drawn."""
    settings_file, drawing = tmp_path / "settings.toml", tmp_path / "drawing.svg"
    settings_file.write_text("")
    drawing.write_text(DRAWING)
    job = prepare(str(drawing), ReadOptions(), resolve({"firmware": firmware, **more}, settings_file).values)
    setup = board_setup(job.settings, job.machine)
    steps = np.array([[3000, 801]])
    here = (0.0, 0.0) if homed else tuple(map(float, setup.kinematics.millimetres(steps)[0]))
    part = Part(1, 3.0, (22.0, 30.0), (here[0], here[1]), homed)
    execute = arithmetic_old.execute if setup.firmware.old_arithmetic else arithmetic.execute
    state, ends = State((3000, 801), acc), 0
    for item in part_program(job, setup, part):
        if isinstance(item, EM | CS):
            state = State()
        elif isinstance(item, MotionCommand):
            state = execute(item, state).state
        elif isinstance(item, StrokeEnd):
            assert state.position == item.steps
            ends += 1
        else:
            assert isinstance(item, Command) or item
    assert ends == job.stroke_count - 1
    assert state.position == (0, 0)
    return sum(isinstance(action, Draw) for action in planned(job))
