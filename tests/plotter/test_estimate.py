"""What a plan consists of, counted as it passes by, against sums done another way."""

from dataclasses import replace

import numpy as np
import pytest

from planning.geometry.stroke import Layer, Stroke
from planning.motion.limits import Limits
from planning.motion.plan import Draw, Lift, Motion, Travel, still
from planning.motion.planner import MotionSettings, PenTiming, plan
from planning.motion.reinking import Reinking
from plotter.estimate import PlannedPause, PlanTally, length_mm
from plotter.machines.profile import load_machine

MACHINE = load_machine("axidraw-v3")
SETTINGS = MotionSettings(
    draw=Limits(100, 1000, 50_000, 0.02),
    travel=Limits(200, 2000, 100_000),
    kinematics=MACHINE.kinematics(),
    pen=PenTiming(0.1, 0.1, 0.05),
    bounds_mm=((0.0, 0.0), (MACHINE.width_mm, MACHINE.height_mm)),
)


def test_the_length_of_a_known_motion() -> None:
    """x = t^2 / 2 over two seconds, at 3-4-5 in the plane: 2 mm along x, 1.5 along y."""
    one = np.array([[1.0, 0.75]])
    motion = Motion(np.array([2.0]), np.zeros((1, 2)), np.zeros((1, 2)), one, np.zeros((1, 2)), np.array([2.0, 1.5]))
    assert length_mm(motion) == pytest.approx(2.5, abs=1e-12)
    assert length_mm(still(np.array([3.0, 4.0]))) == 0.0


def test_a_plan_is_counted_layer_by_layer() -> None:
    circle = np.linspace(0, 2 * np.pi, 200)
    ring = Stroke(np.column_stack((50 + 10 * np.cos(circle), 50 + 10 * np.sin(circle))), np.zeros(200, dtype=bool))
    line = Stroke(np.array([[20.0, 20.0], [60.0, 20.0]]))
    layers = (Layer(1, "ring", (ring,)), Layer(2, "lines", (line, Stroke(np.array([[70.0, 70.0]])))))
    tally = PlanTally()
    actions = list(tally.watch(plan(layers, SETTINGS, np.zeros(2), np.zeros(2))))
    assert [layer.name for layer in tally.layers] == ["ring", "lines"]
    assert [layer.strokes for layer in tally.layers] == [1, 2]
    assert tally.layers[0].pen_down_mm == pytest.approx(20 * np.pi, abs=0.2)
    assert tally.layers[1].pen_down_mm == pytest.approx(40, abs=0.01)
    assert tally.total.pen_lifts == sum(isinstance(action, Lift) for action in actions) == 3
    assert tally.total.strokes == sum(isinstance(action, Draw) for action in actions) == 3
    fine = np.linspace(0, 1, 20_000)
    for kind, counted in ((Travel, tally.total.pen_up_mm), (Draw, tally.total.pen_down_mm)):
        ways = [action.motion.sample(fine * action.motion.total_s)[0] for action in actions if isinstance(action, kind)]
        assert counted == pytest.approx(sum(np.hypot(*np.diff(way, axis=0).T).sum() for way in ways), rel=1e-5)
    left, top, right, bottom = tally.bounds_mm
    assert (left, top) == pytest.approx((20, 20), abs=0.02)
    assert (right, bottom) == pytest.approx((70, 70), abs=0.02)


def test_pauses_are_counted_where_they_are() -> None:
    """Lines of 40 mm in a layer, then one that pauses first; ink lasts for 50 mm, and that pause is a chance to re-ink."""
    lines = tuple(Stroke(np.array([[20.0, y], [60.0, y]])) for y in (20.0, 30.0, 40.0))
    layers = (Layer(1, "black", lines), Layer(3, "!red", lines[:2], pause_before=True))
    tally = PlanTally()
    for _ in tally.watch(plan(layers, replace(SETTINGS, reinking=Reinking(every_mm=50.0)), np.zeros(2), np.zeros(2))):
        pass
    ink, red = "re-ink the pen", "next: !red"
    assert tally.pauses == [PlannedPause(ink, 2, 1), PlannedPause(ink, 3, 1), PlannedPause(red, 4, 3), PlannedPause(ink, 5, 3)]
    assert (tally.total.pauses, [layer.pauses for layer in tally.layers]) == (4, [2, 2])
