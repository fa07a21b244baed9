"""Laws of the encoder, asserted on the exact arithmetic: ends, drift, every tick, direction, time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from output.ebb import arithmetic, arithmetic_old
from output.ebb.arithmetic import ONE_STEP, State
from output.ebb.commands import EM, Command, MotionCommand
from output.ebb.encode import BoardSetup, PenCommands, Sizing, encode, prologue
from output.ebb.firmware import firmware
from output.ebb.program import StrokeEnd
from planning.motion.limits import Kinematics
from planning.motion.plan import Action, Draw, Motion
from tests.output.motion_samples import CARTESIAN, COREXY, drawing, in_parts, spline_motion, straight, wandering

PEN = PenCommands(16000, 24000, 400, 400)
QUICK = settings(max_examples=15, deadline=None, phases=(Phase.explicit, Phase.reuse, Phase.generate))
EVERY = [
    *[
        ("3.0.3", "auto"),
        ("3.0.0", "auto"),
        ("3.0.2", "lt"),
        ("3.0.3", "lm"),
        ("3.0.1", "sm"),
        ("3.0.3", "xm"),
        ("2.8.1", "auto"),
    ],
    *[("2.7.0", "lm"), ("2.8.1", "sm"), ("2.6.0", "auto"), ("2.4.0", "xm"), ("2.0.1", "auto"), ("1.9.0", "auto")],
    *[("2.7.0", "auto"), ("2.5.0", "auto"), ("1.8.0", "auto")],
]
# What the machine's steps are: both AxiDraw ways, coarse and fine ones, and axes that differ and lie askew.
STEPS = st.sampled_from(
    [
        COREXY,
        CARTESIAN,
        Kinematics(np.array([[20.0, 0.0], [0.0, 33.3]]), 25000.0),
        Kinematics(np.array([[40.0, 40.0], [40.0, -40.0]]), 25000.0),
        Kinematics(np.array([[95.0, 11.0], [-7.0, 101.3]]), 25000.0),
    ]
)


def setup_for(version: str, family: str = "auto", kinematics: Kinematics = COREXY, **more: object) -> BoardSetup:
    return BoardSetup(kinematics, firmware(version), PEN, family=family, **more)  # type: ignore[arg-type]


def run(actions: list[Action], setup: BoardSetup) -> tuple[State, list[tuple[StrokeEnd, State]], int]:
    """Play a plan on the arithmetic of its firmware: the end, the state at each stroke's end, and the ticks of motion."""
    execute = arithmetic_old.execute if setup.firmware.old_arithmetic else arithmetic.execute
    state, ends, ticks = State(), [], 0
    for item in [*prologue(setup), *encode(actions, setup)]:
        if isinstance(item, MotionCommand):
            done = execute(item, state)
            assert not done.overflow, item
            state, ticks = done.state, ticks + done.ticks
        elif isinstance(item, EM):
            state = State()
        elif isinstance(item, StrokeEnd):
            ends.append((item, state))
    return state, ends, ticks


@pytest.mark.parametrize(("version", "family"), EVERY)
@settings(QUICK, max_examples=3)
@given(seed=st.integers(0, 10**6), kinematics=STEPS)
def test_every_stroke_ends_on_its_rounded_end(version: str, family: str, seed: int, kinematics: Kinematics) -> None:
    actions = drawing(seed, 4, pieces=25)
    wanted = {a.stroke: kinematics.steps(a.motion.end_mm) for a in actions if isinstance(a, Draw)}
    state, ends, _ = run(actions, setup_for(version, family, kinematics))
    assert len(ends) == 4
    for mark, at in ends:
        assert at.position == mark.steps == tuple(np.rint(wanted[mark.index]).astype(int))
    assert state.position == (0, 0)


def phases_at_ticks(commands: list[Command], start: int, axis: int) -> np.ndarray:
    """The axis's phase after every executing tick of T3 and TD commands, by their rates."""
    parts, phase = [], start
    for command in commands:
        for segment in arithmetic.execute(command, State()).segments:
            profile = segment.profile[axis]
            t = np.arange(1, segment.ticks + 1, dtype=np.int64)
            sums = profile.r0 * t + profile.accel * (t * (t + 1) // 2) + profile.jerk * ((t - 1) * t * (t + 1) // 6)
            parts.append(phase + sums)
            phase += int(sums[-1])
    return np.concatenate(parts)


def draws(parts: list[Motion]) -> list[Action]:
    return [Draw(part, 0, part is parts[-1]) for part in parts]


def every_tick(motion: Motion, setup: BoardSetup, borders: list[int] | None = None) -> tuple[list[np.ndarray], np.ndarray]:
    """Step counters of both axes after every tick, and the plan's steps there. The motion comes in parts, cut at `borders`."""
    commands = [c for c in encode(draws(in_parts(motion, borders or [])), setup) if isinstance(c, Command)]
    start = np.rint(setup.kinematics.steps(motion.start_mm)).astype(int)
    counters = [phases_at_ticks(commands, int(start[axis]) * ONE_STEP + ONE_STEP // 2, axis) >> 31 for axis in (0, 1)]
    times = np.arange(1, len(counters[0]) + 1) * 40e-6
    return counters, setup.kinematics.steps(motion.sample(times)[0])


@QUICK
@given(
    seed=st.integers(0, 10**6),
    ticks=st.one_of(st.integers(180, 400), st.integers(80, 1600)),
    merge=st.sampled_from([0.0, 0.1, 0.4]),
    version=st.sampled_from(["3.0.3", "3.0.0"]),
    kinematics=STEPS,
)
def test_at_every_tick_each_motor_is_within_a_step_of_the_plan(
    seed: int, ticks: int, merge: float, version: str, kinematics: Kinematics
) -> None:
    motion = wandering(seed, 60, ticks, step_mm=ticks * 0.004 * 100 / np.abs(kinematics.steps_per_mm).sum(axis=1).max())
    # How slow a motion would have to be for the queue is not this law's matter.
    sizing = Sizing(merge_steps=merge, least_lead_s=0.0, host_s=0.0)
    counters, wanted = every_tick(motion, setup_for(version, kinematics=kinematics, sizing=sizing))
    assert len(counters[0]) == round(motion.total_s / 40e-6)
    for axis in (0, 1):
        assert np.abs(counters[axis] - wanted[:, axis]).max() <= min(0.5 + merge + 0.17, 1.0)


@QUICK
@given(seed=st.integers(0, 10**6), merge=st.sampled_from([0.0, 0.4]), cuts=st.lists(st.integers(1, 59), min_size=1, max_size=6))
def test_a_stroke_that_comes_in_parts_is_one_motion(seed: int, merge: float, cuts: list[int]) -> None:
    """Every tick within the same bound, no time lost, the same end; and nothing is rounded to a step where parts meet."""
    motion = wandering(seed, 60, 300, step_mm=1.2)
    setup = setup_for("3.0.3", sizing=Sizing(merge_steps=merge, least_lead_s=0.0))
    borders = sorted(set(cuts))
    counters, wanted = every_tick(motion, setup, borders)
    assert len(counters[0]) == round(motion.total_s / 40e-6)
    for axis in (0, 1):
        assert np.abs(counters[axis] - wanted[:, axis]).max() <= min(0.5 + merge + 0.17, 1.0)
    items = list(encode(draws(in_parts(motion, borders)), setup))
    assert [type(item) for item in items if not isinstance(item, Command)] == [StrokeEnd]
    phases = [phases_at_ticks([c for c in items if isinstance(c, Command)], ONE_STEP // 2, axis) for axis in (0, 1)]
    ends = np.rint(np.cumsum(motion.duration_s) / 40e-6).astype(int)[[k - 1 for k in borders]]
    for axis in (0, 1):
        off = (phases[axis][ends - 1] - ONE_STEP // 2) / ONE_STEP - wanted[ends - 1, axis]
        assert np.abs(off).max() <= 1 / 64 + 1 / 500


@pytest.mark.parametrize(("version", "family"), EVERY)
@settings(QUICK, max_examples=2)
@given(seed=st.integers(0, 10**6), kinematics=STEPS)
def test_parts_of_strokes_end_on_the_rounded_end(version: str, family: str, seed: int, kinematics: Kinematics) -> None:
    rng = np.random.default_rng(seed)
    whole = drawing(seed, 3, pieces=90)
    actions: list[Action] = []
    for action in whole:
        if isinstance(action, Draw):
            borders = sorted({int(k) for k in rng.integers(30, len(action.motion) - 30, 2)})
            parts = in_parts(action.motion, borders)
            actions += [Draw(part, action.stroke, part is parts[-1]) for part in parts]
        else:
            actions.append(action)
    setup = setup_for(version, family, kinematics)
    state, ends, ticks = run(actions, setup)
    wanted = {a.stroke: kinematics.steps(a.motion.end_mm) for a in whole if isinstance(a, Draw)}
    assert [mark.index for mark, _ in ends] == [0, 1, 2]
    for mark, at in ends:
        assert at.position == mark.steps == tuple(np.rint(wanted[mark.index]).astype(int))
    assert state.position == (0, 0)
    assert ticks <= run(whole, setup)[2] * 1.05 + 25 * 9


@pytest.mark.parametrize("radius_mm", [2.0, 8.0, 40.0])
@pytest.mark.parametrize("ticks", [416, 836, 1100])
def test_where_an_axis_turns_slowly_long_pieces_are_within_a_step(radius_mm: float, ticks: int) -> None:
    """Circles: at four places an axis stands still for a moment, and a piece that is held back there moves its end."""
    turn = np.linspace(0, 2 * np.pi * 3, round(3 * 2 * np.pi * radius_mm / (0.004 * ticks)))
    points = radius_mm * np.column_stack((np.sin(turn), 1 - np.cos(turn)))
    setup = setup_for("3.0.3", sizing=Sizing(least_lead_s=0.0))
    counters, wanted = every_tick(spline_motion(points, ticks), setup)
    for axis in (0, 1):
        assert np.abs(counters[axis] - wanted[:, axis]).max() <= 1.0


@pytest.mark.parametrize("edge", [0.49, -0.49, 0.4999, 0.1])
def test_an_axis_that_rests_in_the_last_part_still_ends_on_its_step(edge: float) -> None:
    """Motor 2 gets near where rounding changes in the first part and rests there in the next."""
    corner = CARTESIAN.millimetres(np.array([[4000.0, 3000.0 + edge]]))[0]
    first = straight(np.zeros(2), corner, 2000, 5000)
    second = straight(corner, corner + np.array([40.0, 0.0]), 2000, 5000)
    for parts in ([first, second], [*in_parts(first, [2]), *in_parts(second, [1, 3])]):
        _, ends, _ = run(draws(parts), setup_for("3.0.3", kinematics=CARTESIAN))
        assert ends[0][1].position == tuple(np.rint(CARTESIAN.steps(second.end_mm)).astype(int))
        phase = np.array(ends[0][1].acc) / ONE_STEP
        assert (phase >= 1 / 16 - 1 / 64).all()
        assert (phase <= 15 / 16 + 1 / 64).all()


@QUICK
@given(
    angle=st.floats(0.0, 6.2832),
    length=st.floats(0.01, 150.0),
    start=st.tuples(st.floats(0, 100), st.floats(0, 100)),
    ramp=st.integers(20, 4000),
)
def test_a_straight_line_never_steps_back_on_either_axis(angle: float, length: float, start: tuple, ramp: int) -> None:
    begin = np.array(start)
    end = begin + length * np.array([np.cos(angle), np.sin(angle)])
    motion = straight(begin, end, ramp, round(length * 150))
    counters, wanted = every_tick(motion, setup_for("3.0.3"))
    for axis in (0, 1):
        steps = np.diff(counters[axis])
        direction = np.sign(wanted[-1, axis] - setup_for("3.0.3").kinematics.steps(begin)[axis])
        assert (steps * direction >= 0).all()


@settings(QUICK, max_examples=4)
@given(seed=st.integers(0, 10**6))
def test_nothing_is_left_behind_over_many_pieces(seed: int) -> None:
    """The phase at the end is the plan's to a thousandth of a step, whatever the number of pieces: no drift."""
    for pieces in (10, 3000):
        motion = wandering(seed, pieces, 200, step_mm=0.5)
        setup = setup_for("3.0.3", sizing=Sizing(merge_steps=0.0))
        commands = [c for c in encode([Draw(motion, 0)], setup) if isinstance(c, Command)]
        wanted = COREXY.steps(motion.end_mm)
        for axis in (0, 1):
            phase = int(phases_at_ticks(commands, ONE_STEP // 2, axis)[-1]) - ONE_STEP // 2
            assert abs(phase / ONE_STEP - wanted[axis]) < 1 / 16 + 1 / 64 + 1e-3


@pytest.mark.parametrize(("version", "family"), [("3.0.3", "auto"), ("3.0.3", "lt"), ("2.8.1", "lt")])
def test_motion_is_never_sped_up(version: str, family: str) -> None:
    actions = drawing(5, 5)
    planned = round(sum(a.motion.total_s for a in actions if hasattr(a, "motion")) / 40e-6)
    _, _, ticks = run(actions, setup_for(version, family))
    assert planned - 25 * 5 <= ticks
    _, _, ticks = run(actions, setup_for(version, family, sizing=Sizing(least_lead_s=0.15)))
    assert planned - 25 * 5 <= ticks <= planned * 1.2


@pytest.mark.parametrize(("version", "family", "within"), [("2.8.1", "lt", 2.6), ("3.0.3", "lt", 2.6), ("2.6.0", "sm", 4.0)])
@settings(QUICK, max_examples=4)
@given(seed=st.integers(0, 10**6))
def test_where_pieces_meet_older_families_are_close_to_the_plan(version: str, family: str, within: float, seed: int) -> None:
    """Worst fit (1.5 steps for parabolas, 3 for lines), rounding, and the fraction that old accumulators mirror at a turn."""
    motion = wandering(seed, 60, 300, step_mm=0.6)
    setup = setup_for(version, family)
    execute = arithmetic_old.execute if setup.firmware.old_arithmetic else arithmetic.execute
    curve = COREXY.steps(motion.sample(np.linspace(0, motion.total_s, 20000))[0])
    acc = ONE_STEP // 2
    state = State((0, 0), (acc, acc) if family == "lt" else (0, 0))
    for item in encode([Draw(motion, 0)], setup):
        if isinstance(item, Command):
            state = execute(item, state).state
            assert np.abs(curve - state.position).max(axis=1).min() <= within, item
