"""The encoder's doors: heads and tails, marks, families, waits, sizing, and what it refuses."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from output.ebb.arithmetic import ONE_STEP, trunc_div
from output.ebb.command_file import command_text
from output.ebb.commands import EM, LT, SC, SM, SP, SR, T3, TD, XM, Command, MotionCommand
from output.ebb.encode import BoardSetup, FamilyName, PenCommands, encode, epilogue, prologue
from output.ebb.encode_pieces import PRIMED
from output.ebb.encode_quadratic import axis_piece
from output.ebb.firmware import firmware
from output.ebb.program import LayerMark, Mark, PauseMark, Slowed, StrokeEnd, StrokeMark
from output.ebb.verify import verify
from output.errors import BadCommand
from planning.motion.plan import Draw, Dwell, LayerStart, Lift, Lower, OperatorPause, Travel, still
from tests.output.motion_samples import COREXY, drawing, spline_motion, straight, wandering

PEN = PenCommands(16000, 24000, 400, 300)


def setup_for(version: str = "3.0.3", family: FamilyName = "auto", **more: object) -> BoardSetup:
    return BoardSetup(COREXY, firmware(version), PEN, family=family, **more)  # type: ignore[arg-type]


def commands(items: list[Command | Mark]) -> list[Command]:
    return [item for item in items if isinstance(item, Command)]


def test_the_head_sets_the_pen_raises_it_and_starts_at_half_a_step() -> None:
    assert list(prologue(setup_for())) == [
        SC(1, 2), SC(8, 8), SC(4, 16000), SC(5, 24000), SC(11, 400), SC(12, 300), SR(60000, 1), EM(1, 1), SP(1, 500),
        LT(1, 2**30, 0, 2**30, 0),
    ]  # fmt: skip
    old = list(prologue(setup_for("1.8.0")))
    assert SC(10, 400) in old and not [c for c in old if isinstance(c, SR | LT)]
    for version in ("3.0.3", "2.8.1", "2.6.0", "2.4.0", "1.8.0"):
        setup = setup_for(version)
        assert [setup.firmware.refusal(c) for c in commands([*prologue(setup), *epilogue(setup)])].count(None) == len(
            commands([*prologue(setup), *epilogue(setup)])
        )


def test_the_tail_raises_the_pen_and_frees_the_motors_if_asked() -> None:
    assert list(epilogue(setup_for())) == [SP(1), EM(0, 0)]
    assert list(epilogue(setup_for(motors_off_at_end=False))) == [SP(1)]


def test_marks_waits_and_pens_come_in_their_order() -> None:
    dot = still(np.zeros(2))
    actions = [
        LayerStart(3, "red"),
        OperatorPause("red pen"),
        Lower(0.1201, 7),
        Draw(dot, 7),
        Dwell(0.25),
        Lift(0.08),
        Dwell(100.5),
    ]
    setup = dataclasses.replace(setup_for("2.8.1"), pen=dataclasses.replace(PEN, pin=3))
    assert list(encode(actions, setup)) == [
        LayerMark(3, "red"), PauseMark("red pen"), StrokeMark(7), SP(0, 121, 3), StrokeEnd(7, (0, 0)), SM(250, 0, 0),
        SP(1, 80, 3), SM(65535, 0, 0), SM(34965, 0, 0),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("version", "family", "kinds"),
    [
        ("3.0.3", "auto", {"T3", "TD"}), ("3.0.0", "auto", {"T3"}), ("2.8.1", "auto", {"LT"}), ("2.6.9", "auto", {"SM"}),
        ("1.9.5", "auto", {"SM"}), ("3.0.3", "lt", {"LT"}), ("3.0.3", "lm", {"LM"}), ("3.0.3", "sm", {"SM"}),
        ("2.3.0", "xm", {"XM", "SM"}),
    ],
)  # fmt: skip
def test_each_firmware_gets_its_commands(version: str, family: FamilyName, kinds: set[str]) -> None:
    program = list(encode(drawing(2, 3), setup_for(version, family)))
    moving = [
        c
        for c in commands(program)
        if isinstance(c, MotionCommand) and not (isinstance(c, SM) and c == SM(c.duration_ms, 0, 0))
    ]
    assert {c.name for c in moving} <= kinds and len(moving) > 30
    assert all(setup_for(version).firmware.refusal(c) is None for c in commands(program))
    if family == "xm":
        assert sum(isinstance(c, XM) for c in moving) > 0.9 * len(moving)


def test_a_family_that_the_firmware_lacks_is_refused() -> None:
    for version, family in (("2.8.1", "t3"), ("2.6.0", "lt"), ("2.6.0", "lm"), ("2.2.0", "xm")):
        with pytest.raises(BadCommand, match=f"firmware {version} has no .*choose one of"):
            list(encode([], setup_for(version, family)))  # type: ignore[arg-type]
    with pytest.raises(BadCommand, match="there are no commands"):
        list(encode([], setup_for("3.0.3", "g0")))  # type: ignore[arg-type]


def test_faster_than_25_khz_and_gaps_are_refused() -> None:
    with pytest.raises(BadCommand, match=r"step at \d+ Hz, the board steps at most at 25000 Hz"):
        list(encode([Travel(straight(np.zeros(2), np.array([200.0, 100.0]), 1000, 2000))], setup_for()))
    far = wandering(1, 10, start_mm=(5.0, 5.0))
    with pytest.raises(BadCommand, match="the plan has a gap"):
        list(encode([Travel(wandering(2, 10)), Draw(far, 0)], setup_for()))


def test_a_long_straight_cruise_is_few_commands_none_of_them_long() -> None:
    """A pause has to wait for what is on the board."""
    motion = straight(np.zeros(2), np.array([200.0, 30.0]), 800, 60000)
    program = commands(list(encode([Travel(motion)], setup_for())))
    assert max(c.intervals for c in program if isinstance(c, T3)) == 6000 and len(program) <= 14
    assert sum(isinstance(c, TD) for c in program) == 2


@pytest.mark.parametrize("version", ["3.0.3", "2.8.1", "2.4.0"])
def test_what_no_piece_size_can_save_is_slowed_down_and_said(version: str) -> None:
    rng = np.random.default_rng(3)
    scribble = np.cumsum(rng.normal(0, 0.15, (400, 2)), axis=0)
    motion = spline_motion(np.vstack((np.zeros((1, 2)), scribble)), 60)
    program = list(encode([Lower(0.1, 0), Draw(motion, 0), Lift(0.1)], setup_for(version)))
    said = [item for item in program if isinstance(item, Slowed)]
    report = verify(program, firmware(version), COREXY)
    assert len(said) == report.slowed_motions == 1 and report.slowed_most == said[0].most > 1.05
    assert report.pen_down_s - motion.total_s == pytest.approx(report.slowed_s, abs=0.5)
    assert report.predicted_underruns == 0 and report.sendable
    assert report.pen_down_s > motion.total_s * 1.05


def test_no_motion_of_ours_is_predicted_to_starve_any_board() -> None:
    for version in ("3.0.3", "3.0.0", "2.8.1", "2.6.0", "1.9.0"):
        setup = setup_for(version)
        program = [*prologue(setup), *encode(drawing(4, 8, pieces=60, ticks=125), setup), *epilogue(setup)]
        report = verify(program, setup.firmware, COREXY)
        assert report.predicted_underruns == 0 and (report.lowest_lead_s or 1) > 0, (version, report.lowest_lead_s)


def test_the_same_plan_gives_the_same_text() -> None:
    texts = {command_text({"a": 1}, encode(drawing(6, 2), setup_for(version))) for version in ("3.0.3", "3.0.3")}
    assert len(texts) == 1


@pytest.mark.parametrize("family", ["sm", "xm"])
def test_no_fast_motor_waits_for_a_single_step_of_the_other(family: FamilyName) -> None:
    """Along a diagonal one motor hardly turns, and firmware 2.6 takes 2 % more than the time for a step in 28 ms."""
    rng = np.random.default_rng(5)
    along = np.cumsum(np.concatenate((np.linspace(0, 2.0, 20), np.full(200, 2.0), np.linspace(2.0, 0, 20))))
    across = np.cumsum(rng.normal(0, 0.02, len(along)))
    motion = spline_motion(np.vstack((np.zeros((1, 2)), np.column_stack((along + across, along - across)) / 2**0.5)), 500)
    version = firmware("2.6.6")
    program = commands(list(encode([Travel(motion)], setup_for("2.6.6", family))))
    report = verify(program, version, COREXY)
    assert report.max_velocity_jump_mm_s < 30
    assert report.final_steps == tuple(np.rint(COREXY.steps(motion.end_mm)))


@settings(max_examples=200, deadline=None)
@given(
    ticks=st.integers(1, 500),
    share=st.floats(0.9, 1.0),
    change=st.floats(-0.2, 0.2),
    old=st.booleans(),
    way=st.sampled_from([-1, 1]),
)
def test_no_parabola_steps_faster_than_the_board_can(ticks: int, share: float, change: float, old: bool, way: int) -> None:
    target = way * share * ONE_STEP * ticks
    piece = axis_piece(0, PRIMED, ticks, 0.0, target, way * change * ONE_STEP, old=old, final=False)
    first = piece.rate - trunc_div(piece.accel, 2)
    assert 0 <= piece.rate < ONE_STEP
    assert min(first + piece.accel, first + piece.accel * ticks) >= 0
    assert max(first + piece.accel, first + piece.accel * ticks) < ONE_STEP


@pytest.mark.parametrize(("version", "family"), [("2.8.1", "auto"), ("2.8.1", "lm"), ("3.0.3", "lt"), ("3.0.3", "lm")])
def test_parabolas_at_the_boards_fastest(version: str, family: FamilyName) -> None:
    """Travel as fast as the machines do it in draft quality, 24.9 kHz on one motor."""
    diagonal = np.array([1.0, 1.0])
    slow = straight(np.zeros(2), diagonal, 1500, 3000)
    motion = straight(np.zeros(2), diagonal * 24900 / (slow.velocity_mm_s.max() * 160), 1500, 3000)
    setup = dataclasses.replace(setup_for(version), family=family)
    report = verify(list(encode([Travel(motion)], setup)), firmware(version), COREXY)
    assert report.sendable and report.max_step_rate_hz <= 25000
