"""Every sample, from the file to the virtual board's own record of where the pen was down."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from output.ebb.verify_compare import compare
from plotter.cli.main import run
from plotter.cli.plot import ink_mm
from plotter.machines.profile import load_machine
from plotter.svg.read import read_drawing

SAMPLES = sorted((Path(__file__).parents[2] / "samples").glob("*.svg"))
_LONGEST = "stipple"  # thousands of strokes; contours, city and poster have many as well
MACHINE = load_machine("axidraw-v3")
FIRST_LIFT_S = 0.5  # the wait of the set-up's first pen-up, before anything moves


@pytest.fixture(autouse=True)
def _own_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


def test_there_are_samples() -> None:
    assert len(SAMPLES) >= 8


@pytest.mark.parametrize(
    "sample",
    [pytest.param(path, marks=[pytest.mark.long] if path.stem == _LONGEST else [], id=path.stem) for path in SAMPLES],
)
def test_the_ink_is_the_drawing_and_the_time_is_as_promised(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ["--quality", "draft", "--tolerance", "0.02mm"]
    assert run(["preview", str(sample), "--json", *flags]) == 0
    promised = json.loads(capsys.readouterr().out)
    record_file = tmp_path / "record.json"
    assert run(["plot", str(sample), "--port", "sim", "--speed", "200", "--record", str(record_file), *flags]) == 0
    assert f"plotted {sample.name}" in capsys.readouterr().out
    record = json.loads(record_file.read_text())

    wanted = [stroke.points_mm for layer in read_drawing(sample).layers for stroke in layer.strokes]
    deviation = compare(ink_mm(record, MACHINE.kinematics()), wanted)
    assert deviation.drawn.max_mm <= 0.05
    assert deviation.wanted.max_mm <= 0.05

    took_s = record["motion_ticks"] / record["ticks_per_s"] + FIRST_LIFT_S
    assert took_s == pytest.approx(promised["duration_s"], rel=0.01)
    assert len(record["ink"]) == promised["strokes"]
    assert record["pen_up"] is True
    assert not any(record["motors_on"])
    assert record["position"] == [0, 0]
    assert record["parser_blocked"] == []


def test_the_comparison_sees_a_missing_line_and_a_stray_one() -> None:
    lines = [np.array([[0.0, 0.0], [10.0, 0.0]]), np.array([[0.0, 5.0], [10.0, 5.0]])]
    assert compare(lines, lines).drawn.max_mm < 1e-9
    assert compare(lines[:1], lines).wanted.max_mm == pytest.approx(5)
    assert compare(lines, lines[:1]).drawn.max_mm == pytest.approx(5)
    assert compare([line + 0.06 for line in lines], lines).drawn.max_mm > 0.05
