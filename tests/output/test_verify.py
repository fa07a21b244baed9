"""Verify: figures of known moves, everything that must keep a file from being sent, and comparison with a drawing."""

from __future__ import annotations

import io

import numpy as np
import pytest

from output.ebb.command_file import read_command_file
from output.ebb.commands_text import parse_command, with_checksum
from output.ebb.encode import BoardSetup, PenCommands, encode, epilogue, prologue
from output.ebb.estimate import estimate
from output.ebb.firmware import firmware
from output.ebb.queue_forecast import QueueSetup
from output.ebb.verify import Report, compare, verify
from planning.motion.plan import Draw
from tests.output.motion_samples import CARTESIAN, COREXY, drawing, straight

PEN = PenCommands(16000, 24000, 400, 400)


def check(text: str, version: str = "3.0.3", **more: object) -> Report:
    problems: list[str] = []
    _, lines = read_command_file(io.StringIO(text.replace("|", "\n")), problems)
    return verify(lines, firmware(version), CARTESIAN, problems=problems, **more)  # type: ignore[arg-type]


def test_a_constant_move_has_its_known_figures() -> None:
    # 800 steps at 80 per mm and 1000 at 100 in 1 s: 10 mm/s each way, 25001 ticks with rates rounded down.
    report = check("EM,1,1|SP,0,100|SM,1000,800,1000|SP,1,50")
    assert report.final_steps == (800, 1000) and report.final_position_mm == (10.0, 10.0)
    assert report.pen_down_mm == pytest.approx(200**0.5, abs=0.02)
    assert report.max_speed_mm_s == pytest.approx(200**0.5, rel=1e-4)
    assert report.duration_s == pytest.approx((1 + 2500 + 25001 + 1250) * 40e-6)
    assert (report.pen_lifts, report.commands, len(report.strokes)) == (1, 4, 1)
    assert report.max_acceleration_mm_s2 == 0 and report.max_velocity_jump_mm_s == pytest.approx(200**0.5, rel=1e-4)
    assert report.bounds_mm == pytest.approx((0, 0, 10, 10), abs=0.01) and report.sendable


def test_acceleration_and_jerk_are_those_of_the_rates() -> None:
    # Accel 1000 units per tick^2: 1000 / 2^31 / 80 mm / (40 us)^2; jerk likewise.
    report = check("T3,1000,0,1000,0,0,0,0")
    assert report.max_acceleration_mm_s2 == pytest.approx(1000 / 2**31 / 80 / 40e-6**2)
    assert report.max_speed_mm_s == pytest.approx(1000 * 1000 / 2**31 / 80 / 40e-6)
    jerky = check("T3,100,0,0,1000,0,0,0")
    assert jerky.max_jerk_mm_s3 == pytest.approx(1000 / 2**31 / 80 / 40e-6**3)
    assert jerky.max_acceleration_mm_s2 == pytest.approx(100 * 1000 / 2**31 / 80 / 40e-6**2, rel=1e-3)


@pytest.mark.parametrize(
    ("text", "constant"),
    [
        ("EM,1,1|SM,1000,800,1000|XM,500,100,20", "speed"),
        ("LM,100000000,200,0,0,0,0|LT,100,100000000,0,0,0", "speed"),
        ("LT,100,0,1000,0,0|SM,1000,800,1000", "acceleration"),
        ("LM,100000000,200,1000,0,0,0", "acceleration"),
        ("T3,100,0,0,1000,0,0,0|LT,100,0,1000,0,0", "jerk"),
    ],
)
def test_what_the_commands_cannot_say_is_known(text: str, constant: str) -> None:
    report = check(text)
    assert report.constant == report.as_dict()["constant"] == constant


@pytest.mark.parametrize(
    ("line", "said"),
    [
        # Rate - trunc(Accel / 2) + trunc(Jerk / 6), and after t ticks Accel t + Jerk t (t - 1) / 2 more.
        ("T3,250,2147483647,1000000,0,0,0,0", "rate1 becomes 2396983647 within 250 intervals, by accel1 1000000 and jerk1 0"),
        ("T3,250,0,0,0,-2147483000,-3000,0", "rate2 becomes -2148231500 within 250 intervals, by accel2 -3000 and jerk2 0"),
        # Highest where the acceleration has been used up, in tick 100 or 101 of 200.
        ("T3,200,0,60000000,-600000,0,0,0", "rate1 becomes 2999900000 within 200 intervals, by accel1 60000000 and jerk1 -6"),
        ("LM,2147483647,2000,1000000,0,0,0", "rate1 becomes 6288983647 within 4142 intervals, by accel1 1000000 and"),
    ],
)
def test_a_rate_that_rolls_over_is_named_with_its_line_value_and_bound(line: str, said: str) -> None:
    problems = check(f"EM,1,1|{line}|# stroke 1|SP,1,100").problems
    assert len([problem for problem in problems if said in problem]) == 1, problems
    assert problems[0].startswith("line 2: ") and "allowed is -2147483648 to 2147483647 (25 kHz)" in problems[0]


def test_speed_peaks_inside_a_piece_are_found() -> None:
    report = check("T3,1000,0,200000,-400,0,0,0")
    assert report.max_speed_mm_s == pytest.approx(200000**2 / (2 * 400) / 2**31 / 80 / 40e-6, rel=1e-3)


@pytest.mark.parametrize(
    ("text", "version", "said"),
    [
        ("EM,1,1|LM,0,-1,0,1000,5,0", "3.0.3", "never ends"),
        ("LM,1000,5,0,0,3,0", "2.8.1", "never ends"),
        ("T3,2000,2000000000,1000000,0,0,0,0", "3.0.3", "32 bits"),
        ("LT,2000,2000000000,1000000,0,0", "2.8.1", "32 bits"),
        ("SM,10,251,0", "3.0.3", "25 steps per ms"),
        ("SM,10000,5,0", "2.8.1", "1.31"),
        ("T3,10,1,1,1,1,1,1", "2.8.1", "needs firmware 3.0.0"),
        ("TD,10,0,0,1,1,0,0,1,1", "3.0.0", "needs firmware 3.0.1"),
        ("XM,10,1,1", "2.2.0", "needs firmware 2.3.0"),
        ("T3,10,1,1,1,1,1,2147483648", "3.0.3", "line 1"),
        ("PEN UP", "3.0.3", "line 1"),
        ("# nothing", "3.0.3", "no command"),
        ("LM,10,0,5,20,0,5", "3.0.3", "neither axis can move"),
        ("EM,1,1|SP,0,100|SM,100,1600,0", "3.0.3", "jumps by 200.0 mm/s at command 3"),
        ("CU,54,1|SM,100,10,10,252|SM,100,10,10,12", "3.0.3", "line 3: checksum of SM,100,10,10 is 12"),
        ("CU,54,1|SM,100,10,10,252|QG", "3.0.3", "line 3: 'QG' has no checksum"),
    ],
)
def test_what_should_not_be_sent_is_said(text: str, version: str, said: str) -> None:
    report = check(text, version)
    assert not report.sendable and any(said in problem for problem in report.problems), report.problems


@pytest.mark.parametrize("step_mm_s", [14, 28, 86])
def test_staircases_of_speed_are_sendable_with_a_warning(step_mm_s: int) -> None:
    text = "|".join(["EM,1,1", *(f"SM,25,{2 * step_mm_s * k},0" for k in (1, 2, 1)), "SP,1,50"])
    report = check(text)
    assert report.sendable and report.max_velocity_jump_mm_s == pytest.approx(step_mm_s, rel=1e-4)
    assert any(f"jumps by {step_mm_s}.0 mm/s" in warning for warning in report.warnings)
    assert not check("EM,1,1|SM,25,16,0|SP,1,50").warnings


@pytest.mark.parametrize("version", ["3.0.3", "2.8.1"])
def test_a_motor_that_waits_for_the_other_does_not_hide_what_that_one_does(version: str) -> None:
    """Motor 1 speeds up and slows down to rest; motor 2 takes its one step early in the second half."""
    report = check("EM,1,1|LM,1,400,200000,0,0,0|LM,586000000,399,-200000,1530000,1,0|SP,1,50", version)
    assert report.max_speed_mm_s > 80 and report.max_velocity_jump_mm_s < 6


def test_files_with_checksums_are_read() -> None:
    plain = ["EM,1,1", "SP,0,100", "SM,100,400,400", "SP,1,100"]
    summed = check("|".join(["CU,54,1", *map(with_checksum, plain), with_checksum("CU,54,0"), "SM,100,0,0"]))
    assert summed.sendable and summed.commands == 7 and summed.final_steps == check("|".join(plain)).final_steps == (400, 400)


FOREIGN = """EM,1,1

# by hand; every command that moves
sc,4,16000
SC,5,24000
SP,1,500
SM,100,200,200
sp,0,150,4
XM,100,50,-50
LM,85899345,40,0,85899345,40,0
LT,250,-20000000,0,-20000000,0
T3,250,0,0,400,0,0,400
TD,250,0,0,0,100,0,0,0,-100
L3,0,50,100000,10,0,0,0,0
TR,1000,20,-20
HM,1000,200,300
HM,1000
S2,0,4
TP,100
QG
ES
EM,0,0
"""


def test_a_file_by_hand_with_every_moving_command_is_replayed() -> None:
    report = check(FOREIGN)
    assert report.sendable, report.problems
    assert (report.commands, report.pen_lifts, report.final_steps) == (20, 1, (0, 0))
    assert len(report.strokes) == 1
    lacks = check(FOREIGN, "2.8.1").problems
    assert [problem.split()[2] for problem in lacks] == ["T3", "TD", "L3", "TR"] and "line 12" in lacks[0]


def test_leaving_the_machine_is_a_problem() -> None:
    inside = check("SM,1000,800,1000", travel_mm=(0, 0, 10, 10))
    outside = check("SM,1000,800,1100", travel_mm=(0, 0, 10, 10))
    assert inside.sendable and "machine reaches" in outside.problems[0]


def test_running_dry_is_predicted_only_in_motion() -> None:
    pieces = "|".join(["LT,50,100000000,0,50000000,0"] * 40)
    starved = check("SP,1,50|" + pieces, "2.8.1")
    assert starved.predicted_underruns > 20 and "run dry" in starved.problems[-1] and starved.lowest_lead_s < 0  # type: ignore[operator]
    assert check("SP,1,500|" + pieces, queue=QueueSetup(30, 0.0)).predicted_underruns < starved.predicted_underruns
    calm = check("SP,1,50|" + "|".join(["LT,500,100000000,0,50000000,0"] * 40), "2.8.1")
    assert calm.predicted_underruns == 0 and calm.lowest_lead_s > 0  # type: ignore[operator]
    assert check("|".join(["SP,1", "SP,0"] * 50)).predicted_underruns == 0


def test_backward_steps_are_counted() -> None:
    assert check("SM,100,50,0|SM,100,-1,0|SM,100,50,0").backward_steps == 1
    assert check("SM,100,50,0|SM,100,-20,0|SM,100,50,0").backward_steps == 0
    assert check("SM,100,50,0|SP,1,10|SM,100,-1,0|SP,1,10|SM,100,50,0").backward_steps == 0


def test_pens_toggles_servos_and_dots() -> None:
    report = check("SC,4,20000|SC,5,10000|TP,10|SM,100,80,0|TP,10|SM,100,80,0|S2,10100,4,0,20|S2,19000,4|SP,0,5|SP,1")
    assert report.pen_lifts == 3 and [len(stroke) for stroke in report.strokes] == [2, 1, 1]
    np.testing.assert_allclose(report.strokes[1], [[2.0, 0.0]])


def test_positions_go_on_through_em_and_cs_and_steps_have_their_size() -> None:
    report = check("EM,1,1|SM,100,80,0|EM,1,1|SM,100,80,0|CS|HM,1000,80,100|EM,2,2|SM,100,40,0|EM,0,0")
    assert report.final_steps == (80 + 80 + 80 + 80, 100)
    assert report.final_position_mm == pytest.approx((4.0, 1.0))


@pytest.mark.parametrize("version", ["3.0.3", "3.0.0", "2.8.1", "2.6.0", "1.9.0"])
def test_an_encoded_plan_is_as_planned_and_sendable(version: str) -> None:
    actions = drawing(8, 6, pieces=40, ticks=400)
    setup = BoardSetup(COREXY, firmware(version), PEN)
    program = [*prologue(setup), *encode(actions, setup), *epilogue(setup)]
    report = verify(program, firmware(version), COREXY)
    assert report.sendable, report.problems
    wanted = [a.motion.sample(np.linspace(0, a.motion.total_s, 4000))[0] for a in actions if isinstance(a, Draw)]
    apart = compare(report.strokes, wanted)
    assert max(apart.drawn.max_mm, apart.wanted.max_mm) < (0.03 if version.startswith("3") else 0.06)
    assert report.pen_lifts == 6 and report.final_steps == (0, 0)
    if version.startswith("3"):
        assert report.max_velocity_jump_mm_s < 0.1
    times = estimate(program, firmware(version))
    assert times.duration_s == pytest.approx(report.duration_s) and times.commands == report.commands
    assert times.pen_down_s + times.pen_up_s + times.pen_lift_s == pytest.approx(times.duration_s)
    assert [(layer.number, layer.name) for layer in times.layers] == [(0, ""), (1, "all")]


def test_td_is_used_for_the_two_halves_of_a_ramp_and_moves_the_same() -> None:
    actions = [Draw(straight(np.zeros(2), np.array([30.0, 12.0]), 800, 4000), 0)]
    with_td = list(encode(actions, BoardSetup(COREXY, firmware("3.0.3"), PEN)))
    without = list(encode(actions, BoardSetup(COREXY, firmware("3.0.0"), PEN)))
    names = [getattr(item, "name", "") for item in with_td]
    assert names.count("TD") == 2 and "TD" not in [getattr(item, "name", "") for item in without]
    one, two = verify(with_td, firmware("3.0.3"), COREXY), verify(without, firmware("3.0.0"), COREXY)
    assert one.final_steps == two.final_steps and one.duration_s == pytest.approx(two.duration_s)
    assert one.max_velocity_jump_mm_s < 0.1


def test_compare_measures_both_ways() -> None:
    line = np.array([[0.0, 0.0], [10.0, 0.0]])
    shifted = line + np.array([0.0, 0.3])
    apart = compare([line], [shifted, np.array([[5.0, 2.3]])])
    assert apart.drawn.max_mm == pytest.approx(0.3, abs=0.01) and apart.drawn.mean_mm == pytest.approx(0.3, abs=0.01)
    assert apart.wanted.max_mm == pytest.approx(2.3, abs=0.01) and apart.wanted.p99_mm == pytest.approx(0.3, abs=0.01)
    with pytest.raises(ValueError, match="nothing to compare"):
        compare([], [line])


def test_parameters_of_any_size_are_replayed_without_overflow_of_ours() -> None:
    report = verify([parse_command("T3,900000,2147483647,2147483647,2147483647,-5,-2147483648,7")], firmware(), CARTESIAN)
    assert not report.sendable and np.isfinite(report.max_speed_mm_s)


def test_a_pen_down_whose_height_was_never_set_is_warned_of() -> None:
    """The stop of an earlier program has taken it from the board, and such a file draws nothing."""
    drawn = "SP,0,100|SM,1000,800,1000|SP,1,50|SP,0,100|SM,1000,-800,-1000|SP,1,50"
    (warning, _jump) = check(f"EM,1,1|{drawn}").warnings
    assert warning.startswith("SP,0,100 lowers the pen without its height having been set")
    (_jump,) = check(f"SC,4,16000|SC,5,24000|EM,1,1|{drawn}").warnings
