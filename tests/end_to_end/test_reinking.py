"""Re-inking: never more ink than was asked for between two visits, nothing drawn at the well, the drawing as it was."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st

from output.ebb.command_file import read_command_file, write_command_file
from output.ebb.commands import SP, Command
from output.ebb.control import StopFlag
from output.ebb.program import DipMark, Mark
from output.ebb.session import connect
from output.ebb.verify import verify
from output.ebb.verify_compare import compare
from planning.errors import OutsideMachine
from planning.geometry.stroke import Layer, Stroke
from planning.motion.plan import TICK_S, Action, Dip, Draw, LayerStart, Lift, Lower, OperatorPause, Travel, plan_seconds
from planning.motion.planner import plan
from planning.motion.reinking import Reinking
from planning.ordering.arrange import OrderOptions, order_layers
from plotter.board_setup import board_setup
from plotter.cli.main import run
from plotter.errors import BadInput
from plotter.pipeline import motion_settings, program
from plotter.settings import Settings, resolve
from tests.output.board_in_memory import MemoryBoard
from tests.output.inline_producer import inline_producer  # noqa: F401 - a fixture

HOME = np.zeros(2)
WELL = (200.0, 15.0)


@pytest.fixture(autouse=True)
def _own_settings(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))


def drawing(seed: int = 1, count: int = 14) -> tuple[Layer, ...]:
    """Two layers of lines from a dot to 180 mm long."""
    rng = np.random.default_rng(seed)
    strokes = []
    for k in range(count):
        turns = rng.uniform(-1, 1, (k % 4, 2)) * (5, 60)[k % 2]
        points = np.clip(np.cumsum(np.vstack((rng.uniform(20, 150, (1, 2)), turns)), axis=0), 1, 170)
        strokes.append(Stroke(points))
    return Layer(1, "one", tuple(strokes[: count // 2])), Layer(2, "two", tuple(strokes[count // 2 :]))


def planned(values: Settings, layers: tuple[Layer, ...], order: str = "none") -> tuple[list[Action], tuple[Layer, ...]]:
    options = OrderOptions(order, 0.01, max_stroke_mm=values.longest_stroke_mm)  # type: ignore[arg-type]
    ordered = order_layers(layers, options, HOME)
    return list(plan(ordered, motion_settings(values, values.machine_profile()), HOME, HOME)), ordered


def ink_between(actions: list[Action]) -> list[float]:
    """Millimetres drawn from one re-inking to the next, from the beginning on."""
    drawn = [0.0]
    for action in actions:
        if isinstance(action, Dip | OperatorPause):
            drawn.append(0.0)
        elif isinstance(action, Draw):
            points = action.motion.sample(np.linspace(0, action.motion.total_s, 2000))[0]
            drawn[-1] += float(np.hypot(*np.diff(points, axis=0).T).sum())
    return drawn


@examples(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 50),
    every=st.sampled_from(["30mm", "90mm", "500mm", "1s", "4s"]),
    well=st.sampled_from([None, "200mm,15mm", "0,0"]),
    order=st.sampled_from(["none", "greedy", "best"]),
)
def test_what_is_drawn_does_not_change_and_ink_does_not_run_out(seed: int, every: str, well: str | None, order: str) -> None:
    layers = drawing(seed)
    values = resolve({"reink_every": every, "well": well} if well else {"reink_every": every}).values
    actions, ordered = planned(values, layers, order)
    lines = [a.motion.sample(np.linspace(0, a.motion.total_s, 1000))[0] for a in actions if isinstance(a, Draw)]
    found = compare(lines, [stroke.points_mm for layer in layers for stroke in layer.strokes])
    assert found.drawn.max_mm <= 0.06
    assert found.wanted.max_mm <= 0.06
    assert [a.stroke for a in actions if isinstance(a, Lower)] == list(range(sum(len(layer.strokes) for layer in ordered)))
    if every.endswith("mm"):
        assert max(ink_between(actions)) <= float(every[:-2]) * 1.001
    else:
        assert max(time_between(actions)) <= float(every[:-1]) + longest_stroke_s(actions)
    for k, action in enumerate(actions):
        if isinstance(action, Dip):
            before = actions[k - 1]
            assert isinstance(before, Travel)
            assert tuple(before.motion.end_mm) == (WELL if well == "200mm,15mm" else (0.0, 0.0))
            lifts = [a for a in actions[:k] if isinstance(a, Lift)]
            assert not lifts or lifts[-1].height == "up"
    assert sum(isinstance(a, Dip) for a in actions) == (len(ink_between(actions)) - 1 if well else 0)
    if well:
        assert isinstance(next(a for a in actions if not isinstance(a, LayerStart | Travel)), Dip)


def time_between(actions: list[Action]) -> list[float]:
    passed = [0.0]
    for action in actions:
        if isinstance(action, Dip | OperatorPause):
            passed.append(0.0)
        else:
            passed[-1] += plan_seconds(action)
    return passed


def longest_stroke_s(actions: list[Action]) -> float:
    """From one lift to the next: what a visit may come late."""
    times, at = [0.0], 0.0
    for action in actions:
        at += plan_seconds(action)
        if isinstance(action, Lift):
            times.append(at)
    return max(np.diff(times)) + 3.0


@pytest.mark.usefixtures("inline_producer")
@pytest.mark.parametrize("firmware", ["3.0.3", "2.8.1"])
def test_on_the_board_the_pen_goes_down_in_the_well_and_nowhere_else_beside_the_strokes(firmware: str) -> None:
    values = resolve({"reink_every": "120mm", "well": "200mm,15mm", "firmware": firmware, "dip": "300ms"}).values
    actions, ordered = planned(values, drawing())
    setup = board_setup(values, values.machine_profile())
    items = list(program(iter(actions), setup))
    memory = MemoryBoard(firmware)
    board = connect(memory, clock=memory.clock)
    assert board.stream(items, on_progress=lambda _: None, stop=StopFlag()).outcome == "done"
    record = memory.record()
    ink = [setup.kinematics.millimetres(np.array(s["points"], dtype=float)) for s in record["ink_touching"]]
    dips = [line for line in ink if np.abs(line - WELL).max() < 0.02]
    assert len(dips) == sum(isinstance(a, Dip) for a in actions)
    assert len(dips) > 3
    assert all(len(line) == 1 for line in dips)
    for k, stroke in enumerate(record["ink_touching"]):
        if np.abs(ink[k] - WELL).max() < 0.02:
            assert (stroke["up_tick"] - stroke["down_tick"]) * TICK_S > 0.3
    lines = [line for line in ink if np.abs(line - WELL).max() >= 0.02]
    found = compare(lines, [stroke.points_mm for layer in ordered for stroke in layer.strokes])
    assert found.drawn.max_mm <= 0.06
    assert found.wanted.max_mm <= 0.06
    if firmware.startswith("3"):
        assert record["underruns"] == 0


def test_verify_and_the_command_file_know_a_dip_from_ink() -> None:
    values = resolve({"reink_every": "120mm", "well": "200mm,15mm"}).values
    actions, ordered = planned(values, drawing())
    setup = board_setup(values, values.machine_profile())
    items = list(program(iter(actions), setup))
    text = io.StringIO()
    write_command_file(text, {}, items)
    assert "# dip\n" in text.getvalue()
    text.seek(0)
    lines = list(read_command_file(text)[1])
    assert [line.item for line in lines] == items
    report = verify(lines, setup.firmware, setup.kinematics)
    assert report.problems == []
    assert len(report.strokes) == sum(len(layer.strokes) for layer in ordered)
    wanted = [stroke.points_mm for layer in ordered for stroke in layer.strokes]
    assert compare(report.strokes, wanted).drawn.max_mm <= 0.06
    # Without its mark a dip is a dot on the paper.
    unmarked: list[Command | Mark] = [item for item in items if not isinstance(item, DipMark)]
    seen = verify(unmarked, setup.firmware, setup.kinematics)
    assert len(seen.strokes) > len(report.strokes)
    assert compare(seen.strokes, wanted).drawn.max_mm > 10


def test_without_a_well_the_operator_is_asked() -> None:
    values = resolve({"reink_every": "120mm"}).values
    actions, _ = planned(values, drawing())
    pauses = [a for a in actions if isinstance(a, OperatorPause)]
    assert pauses == [OperatorPause("re-ink the pen")] * len(pauses)
    assert len(pauses) == len(ink_between(actions)) - 1 > 3
    assert not any(isinstance(a, OperatorPause | Dip) for a in planned(resolve({}).values, drawing())[0])


def test_a_pause_for_the_pen_is_a_chance_to_re_ink() -> None:
    """The layer's own pause stands for the one that would be due; a well is visited after it, for the pen is another one."""
    one = Stroke(np.array([[10.0, 10.0], [100.0, 10.0]]))
    layers = (Layer(1, "a", (one,)), Layer(2, "b", (one,), None, True))
    for well, expected in ((None, ["next: b"]), ("200mm,15mm", ["dip", "next: b", "dip"])):
        flags = {"reink_every": "100mm"} | ({"well": well} if well else {})
        actions, _ = planned(resolve(flags).values, layers)
        seen = [a.message if isinstance(a, OperatorPause) else "dip" for a in actions if isinstance(a, OperatorPause | Dip)]
        assert seen == expected


def test_a_well_outside_the_machine_is_refused_with_its_place(tmp_path: Any, capsys: pytest.CaptureFixture[str]) -> None:
    values = resolve({"reink_every": "1m", "well": "301mm,15mm"}).values
    with pytest.raises(OutsideMachine, match=r"the well at 301, 15 mm is outside .* x 0 to 300 mm, y 0 to 218 mm"):
        planned(values, drawing())
    file = tmp_path / "drawing.svg"
    file.write_text('<svg xmlns="http://www.w3.org/2000/svg" width="50mm" height="50mm"><path d="M9 9h9" stroke="red"/></svg>')
    assert run(["preview", str(file), "--reink-every", "1m", "--well", "10mm,-0.1mm"]) == 2
    assert "the well at 10, -0.1 mm" in capsys.readouterr().err
    assert run(["export", str(file), "-o", "-", "--reink-every", "1m", "--well", "10mm,0mm"]) == 0
    out = capsys.readouterr().out
    assert "# dip" in out


@pytest.mark.parametrize(
    ("flags", "part"),
    [
        ({"reink_every": "2"}, "'2' is neither a length, like 2m, nor a time, like 5min"),
        ({"reink_every": "0m"}, "more than nothing"),
        ({"reink_every": "-5min"}, "more than nothing"),
        ({"reink_every": "1e7m"}, "at most 1000 m"),
        ({"reink_every": "1m", "well": "3mm"}, "two lengths with a comma"),
        ({"well": "3mm,3mm"}, "needs --reink-every"),
        ({"reink_every": "1m", "well": "3mm,3mm", "dip": "61s"}, "at most 60"),
    ],
)
def test_what_makes_no_sense_is_refused_by_name(flags: dict[str, str], part: str) -> None:
    with pytest.raises(BadInput, match=part):
        resolve(flags)


@pytest.mark.parametrize(
    "wrong", [{"every_mm": 0.0}, {"every_s": -1.0}, {"dip_s": np.nan}, {"well_mm": np.array([1.0, np.inf])}]
)
def test_rules_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Reinking(**wrong)


def test_old_firmware_dips_with_the_same_commands() -> None:
    values = resolve({"reink_every": "120mm", "well": "200mm,15mm", "firmware": "1.9.5"}).values
    items = list(program(iter(planned(values, drawing())[0]), board_setup(values, values.machine_profile())))
    marks = [k for k, item in enumerate(items) if isinstance(item, DipMark)]
    assert marks
    for k in marks:
        down, up = (item for item in items[k + 1 : k + 6] if isinstance(item, SP))
        assert (down.value, up.value) == (0, 1)
