"""The planner's door: order of actions, numbering, streaming, bounds, modes and errors."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from planning.errors import OutsideMachine
from planning.geometry.stroke import Layer, Stroke
from planning.motion import draw
from planning.motion.limits import Kinematics, Limits
from planning.motion.plan import TICK_S, Draw, Dwell, LayerStart, Lift, Lower, OperatorPause, Travel, joined_motion
from planning.motion.planner import MotionSettings, PenTiming, check_bounds, plan
from planning.motion.travel import travel
from tests.planning.motion_checks import assert_keeps_all_laws, samples

COREXY = Kinematics(np.array([[80.0, 80.0], [80.0, -80.0]]), 25000.0)
DRAW = Limits(150, 2000, 100e3, 0.02)
BOUNDS = ((0.0, 0.0), (300.0, 218.0))


def settings(**changes: object) -> MotionSettings:
    values = {
        "draw": DRAW,
        "travel": Limits(300, 3000, 200e3),
        "kinematics": COREXY,
        "pen": PenTiming(0.12, 0.2, 0.05),
        "bounds_mm": BOUNDS,
    }
    return MotionSettings(**{**values, **changes})  # type: ignore[arg-type]


def stroke(*points: tuple[float, float]) -> Stroke:
    return Stroke(np.array(points, dtype=np.float64))


SQUARE = stroke((10, 10), (30, 10), (30, 30), (10, 30), (10, 10))


def test_actions_come_in_order_and_strokes_are_numbered_through() -> None:
    layers = [
        Layer(1, "black", (SQUARE, stroke((5, 5)))),
        Layer(3, "red", (stroke((1, 1), (9, 9)),), color="#ff0000", pause_before=True),
    ]
    actions = list(plan(layers, settings(), np.zeros(2), np.zeros(2)))
    kinds = [type(a) for a in actions]
    assert kinds == [LayerStart, Travel, Lower, Draw, Lift, Travel, Lower, Draw, Dwell, Lift,
                     LayerStart, OperatorPause, Travel, Lower, Draw, Lift, Travel]  # fmt: skip
    assert [a.stroke for a in actions if isinstance(a, Draw)] == [0, 1, 2]
    assert [a.stroke for a in actions if isinstance(a, Lower)] == [0, 1, 2]
    assert {a.wait_s for a in actions if isinstance(a, Lower)} == {0.12}
    assert {a.wait_s for a in actions if isinstance(a, Lift)} == {0.2}
    pause = next(a for a in actions if isinstance(a, OperatorPause))
    assert "red" in pause.message


def test_pauses_that_fall_together_are_one_that_names_all() -> None:
    pen = Layer(4, "!red", (SQUARE,), color="#ff0000", pause_before=True, pause_for=("! wash", "! change"))
    plain = Layer(5, "blue", (SQUARE,), pause_before=True, pause_for=("! change",))
    actions = plan([Layer(1, "", (SQUARE,)), pen, plain], settings(), np.zeros(2), None)
    messages = [action.message for action in actions if isinstance(action, OperatorPause)]
    assert messages == ["! wash, ! change, next: !red, pen #ff0000", "! change, next: blue"]


def test_no_layers_is_just_the_way_home() -> None:
    (way,) = plan([], settings(), np.array([3.0, 4.0]), np.zeros(2))
    assert isinstance(way, Travel)
    assert (way.motion.end_mm == 0.0).all()


def test_without_an_end_the_pen_stays_over_the_last_stroke() -> None:
    actions = list(plan([Layer(1, "", (SQUARE,))], settings(), np.zeros(2), None))
    assert isinstance(actions[-1], Lift)


def test_the_first_stroke_is_planned_before_the_rest() -> None:
    """Taking the first few actions must not plan a thousand strokes."""
    planned: list[int] = []
    original = draw.fit_sections

    def counted(sections, *rest):  # type: ignore[no-untyped-def]
        planned.append(len(sections))
        return original(sections, *rest)

    many = tuple(stroke((x, 1), (x + 0.1, 5), (x, 9), (x + 0.1, 12)) for x in np.linspace(1, 280, 1000))
    draw.fit_sections = counted
    try:
        first = list(itertools.islice(plan([Layer(1, "", many)], settings(), np.zeros(2), None), 4))
    finally:
        draw.fit_sections = original
    assert isinstance(first[-1], Draw)
    assert 0 < sum(planned) <= 20


def test_the_pen_travels_while_a_long_first_stroke_is_planned(monkeypatch: pytest.MonkeyPatch) -> None:
    fitted: list[int] = []
    original = draw.fit_sections

    def watched(sections, *rest):  # type: ignore[no-untyped-def]
        fitted.append(max(len(section.points_mm) for section in sections))
        return original(sections, *rest)

    monkeypatch.setattr(draw, "fit_sections", watched)
    zigzag = stroke(*((20 + 0.3 * i, 50 + 2 * (i % 2)) for i in range(500)))
    actions = plan([Layer(1, "", (zigzag, SQUARE))], settings(), np.zeros(2), None)
    first = list(itertools.islice(actions, 3))
    assert [type(action) for action in first] == [LayerStart, Travel, Lower]
    assert fitted == [], "nothing of the stroke is planned yet"
    part = next(actions)
    assert isinstance(part, Draw)
    assert not part.last, "a stroke that is waited for comes in parts, though it is short for that"
    assert max(fitted) < 400
    rest = list(actions)
    assert [type(action) for action in rest if not isinstance(action, Draw)] == [Lift, Travel, Lower, Lift]
    whole = [part.motion, *(action.motion for action in rest if isinstance(action, Draw) and action.stroke == 0)]
    assert_keeps_all_laws(joined_motion(whole), zigzag.points_mm, DRAW)


def test_a_drawing_that_sticks_out_is_refused_with_the_stroke_and_what_to_do() -> None:
    layers = [Layer(1, "ok", (SQUARE,)), Layer(2, "wide", (stroke((10, 10), (301.5, 20)),))]
    with pytest.raises(OutsideMachine, match=r"layer 2 \(wide\), stroke 1 sticks out 1\.5 mm .*move or scale"):
        check_bounds(layers, BOUNDS)
    far = [Layer(1, "ok", (SQUARE,)), Layer(4, "far", (SQUARE, stroke((9700 + 300, 20))))]
    with pytest.raises(OutsideMachine, match=r"layer 4 \(far\), stroke 2 sticks out 9700 mm .*\(--fit does\)"):
        check_bounds(far, BOUNDS)
    with pytest.raises(OutsideMachine, match="wide"):
        list(plan(layers, settings(), np.zeros(2), None))
    check_bounds([Layer(1, "edge", (stroke((0, 0), (300, 218)),))], BOUNDS)


def test_constant_speed_draws_a_stroke_more_evenly() -> None:
    """A rounded shape with a straight part: the spread of speed away from the ends is smaller, and every law still holds."""
    t = np.linspace(0.0, np.pi, 60)
    arc = np.stack((60 + 4 * np.sin(t), 20 + 4 * (1 - np.cos(t))), axis=-1)
    shape = np.concatenate((np.array([[10.0, 20.0]]), arc, np.array([[10.0, 28.0]])))
    spread = {}
    for even in (False, True):
        actions = plan([Layer(1, "", (Stroke(shape),))], settings(constant_speed=even), np.zeros(2), None)
        motion = next(a.motion for a in actions if isinstance(a, Draw))
        assert_keeps_all_laws(motion, shape, DRAW)
        v = np.hypot(*samples(motion)[1].T)
        inner = v[int(0.15 * len(v)) : int(0.85 * len(v))]
        spread[even] = float(inner.max() / inner.min())
    assert spread[False] > 1.5
    assert spread[True] < 1.2


def test_constant_speed_takes_dots_and_lines_too() -> None:
    shapes = (stroke((5, 5)), stroke((5, 5), (5, 5)), stroke((5, 5), (50, 5)), SQUARE)
    actions = plan([Layer(1, "", shapes)], settings(constant_speed=True), np.zeros(2), None)
    motions = [a.motion for a in actions if isinstance(a, Draw)]
    assert [len(m) > 0 for m in motions] == [False, False, True, True]


def test_a_slow_motor_bounds_the_speed_in_its_own_direction() -> None:
    slow = Kinematics(np.array([[80.0, 80.0], [80.0, -80.0]]), 8000.0)
    fast_line, slow_line = stroke((10, 10), (200, 10)), stroke((10, 10), (150, 150))
    speeds = []
    for s in (fast_line, slow_line):
        (motion,) = draw.draw_motions([s], DRAW, slow)
        v = samples(motion)[1]
        assert np.abs(slow.steps(v)).max() <= 8000.0 * (1 + 1e-9)
        speeds.append(float(np.hypot(*v.T).max()))
    assert speeds[0] == pytest.approx(100.0, rel=1e-3)
    assert speeds[1] == pytest.approx(8000 / (80 * 2**0.5), rel=1e-3)


def test_pen_times_must_make_sense() -> None:
    with pytest.raises(ValueError, match="lower_s"):
        PenTiming(-0.1, 0.2)
    with pytest.raises(ValueError, match="dot_dwell_s"):
        PenTiming(0.1, 0.2, float("nan"))


def test_a_motion_cut_in_two_is_the_same_motion() -> None:
    """At every tick, piece borders included: state and jerk go on, and the parts last as long as the whole."""
    whole = travel(np.array([10.0, 10.0]), np.array([48.0, 21.0]), Limits(200, 2000, 100e3), COREXY, BOUNDS)
    borders = np.rint(np.cumsum(whole.duration_s) / TICK_S).astype(int)
    for at in sorted({1, 777, *borders[:-1].tolist(), int(borders[-1]) - 1}):
        first, rest = whole.split(at * TICK_S)
        assert round((first.total_s + rest.total_s) / TICK_S) == borders[-1]
        assert round(first.total_s / TICK_S) == at
        ends, starts = first.ends(), (rest.position_mm, rest.velocity_mm_s, rest.acceleration_mm_s2)
        for end, start in zip(ends, starts, strict=True):
            np.testing.assert_allclose(end[-1], start[0], atol=1e-6)
        last = rest.ends()
        np.testing.assert_allclose(last[0][-1], whole.end_mm, atol=1e-9)
        np.testing.assert_allclose(last[1][-1], 0.0, atol=1e-6)
    assert [len(part) for part in whole.split(0.0)] == [0, len(whole)]
    assert [len(part) for part in whole.split(whole.total_s)] == [len(whole), 0]
