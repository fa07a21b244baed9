"""Merging and slowing down: only where the queue would hold too little, and within what is promised."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from output.ebb.arithmetic import ONE_STEP
from output.ebb.encode import BoardSetup, PenCommands, Sizing, encode, prologue
from output.ebb.encode_merge import merge
from output.ebb.encode_pieces import Borders, along, borders_of
from output.ebb.encode_slow import rises, slowed, too_fast
from output.ebb.firmware import firmware
from output.ebb.program import Slowed
from output.ebb.verify import compare, verify
from planning.geometry.stroke import Stroke
from planning.motion.draw import draw_motions
from planning.motion.limits import Limits
from planning.motion.plan import Action, Draw, Lift, Lower, Motion
from tests.output.motion_samples import COREXY, in_parts, spline_motion, wandering

PEN = PenCommands(16000, 24000, 400, 300)
TO_MM = np.linalg.inv(COREXY.steps_per_mm).T / ONE_STEP


def everywhere(ticks: np.ndarray) -> np.ndarray:
    return np.ones(len(ticks), dtype=np.bool_)


def at_every_tick(borders: Borders) -> tuple[np.ndarray, np.ndarray]:
    """Positions and rates in steps after each tick."""
    time = np.concatenate(([0], np.cumsum(borders.ticks)))
    tick = np.arange(int(time[-1]))
    piece = np.searchsorted(time, tick, side="right") - 1
    x, v = along(borders, piece, (tick - time[piece]).astype(np.float64))
    return x / ONE_STEP, v / ONE_STEP


def accelerations(borders: Borders) -> np.ndarray:
    """mm/s^2 in the middle of each tick."""
    return np.asarray(np.hypot(*(np.diff(at_every_tick(borders)[1], axis=0) @ (TO_MM * ONE_STEP)).T) / 40e-6**2)


def corners(count: int, ticks: int = 200) -> Motion:
    """Corners one after the other, rounded as a plan rounds them: a turn every 14 knots."""
    rng = np.random.default_rng(4)
    heading = np.repeat(rng.uniform(0, 6.28, count // 14 + 1), 14)[:count]
    steps = 0.4 * np.column_stack((np.cos(heading), np.sin(heading)))
    smooth = np.column_stack([np.convolve(steps[:, k], np.hanning(9) / np.hanning(9).sum(), "same") for k in (0, 1)])
    return spline_motion(np.vstack((np.zeros((1, 2)), np.cumsum(smooth, axis=0))), ticks)


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 10**6), ticks=st.integers(120, 300), most=st.sampled_from([0.02, 0.1, 0.4]))
def test_merged_motion_stays_within_its_tolerance_at_every_tick(seed: int, ticks: int, most: float) -> None:
    borders = borders_of(wandering(seed, 80, ticks, step_mm=ticks * 0.002), COREXY, np.zeros(2))
    merged = merge(borders, most, everywhere, TO_MM)
    assert merged.ticks.sum() == borders.ticks.sum() and len(merged) <= len(borders)
    (x, v), (wanted, rates) = at_every_tick(merged), at_every_tick(borders)
    # Between the three places of each piece that are looked at, a hair more.
    assert np.abs(x - wanted).max() <= most * 1.1
    for end in (0, -1):
        np.testing.assert_allclose(merged.x[end], borders.x[end], atol=8.0)
        np.testing.assert_allclose(merged.v[end], borders.v[end], atol=0.01)
    assert accelerations(merged).max() <= 1.3 * accelerations(borders).max()
    for axis in (0, 1):
        if rates[:, axis].min() >= 0:
            assert v[:, axis].min() >= -3e-3 * np.abs(rates[:, axis]).max()


def test_a_merged_axis_does_not_turn_back_where_the_plan_does_not() -> None:
    t = np.linspace(0, 3, 150)
    borders = borders_of(spline_motion(np.column_stack((t**2, 0.02 * t)), 150), COREXY, np.zeros(2))
    merged = merge(borders, 0.4, everywhere, TO_MM)
    assert len(merged) < len(borders) / 3
    assert at_every_tick(merged)[1].min() >= -1e-6


def test_pieces_are_merged_only_where_they_are_asked_for() -> None:
    borders = borders_of(corners(300), COREXY, np.zeros(2))

    def late(ticks: np.ndarray) -> np.ndarray:
        return np.asarray(np.cumsum(ticks) > 30000)

    merged = merge(borders, 0.4, late, TO_MM)
    same = int(np.argmax(merged.ticks != borders.ticks[: len(merged)]))
    assert 145 <= same <= 151 and len(merged) < 240
    assert np.abs(at_every_tick(merged)[0] - at_every_tick(borders)[0])[:29000].max() < 0.01
    assert merge(borders, 0.0, everywhere, TO_MM) is borders


def test_borders_between_knots_make_fewer_pieces_within_the_same_tolerance(monkeypatch: pytest.MonkeyPatch) -> None:
    """Right angles 2 mm apart, as they are planned: three knots are far more exact than need be, and four too far off."""
    rng = np.random.default_rng(2)
    turns = np.cumsum(rng.choice([-1, 1], 250)) * np.pi / 2
    path = 2.0 * np.cumsum(np.column_stack((np.cos(turns), np.sin(turns))), axis=0)
    limits = Limits(100.0, 1000.0, 50_000.0, 0.02)
    (planned,) = draw_motions([Stroke(path)], limits, COREXY)
    borders = borders_of(planned, COREXY, path[0])

    def lacking(ticks: np.ndarray) -> np.ndarray:
        return np.maximum(1.3 - ticks * 40e-6 * 30, 0.0)

    close = merge(borders, 0.4, lacking, TO_MM)
    monkeypatch.setattr("output.ebb.encode_merge._WORTH", np.inf)
    coarse = merge(borders, 0.4, lacking, TO_MM)
    assert len(close) < 0.85 * len(coarse)
    assert np.abs(at_every_tick(close)[0] - at_every_tick(borders)[0]).max() <= 0.4 * 1.1


def test_merging_gives_a_second_of_lead_and_dense_corners_take_little_more_time_for_it() -> None:
    slower = {}
    t = np.linspace(0, 25, 1300)
    calm = spline_motion(np.column_stack((3 * t, 4 * np.sin(t))), 200)
    for name, motion in (("corners", corners(900)), ("calm", calm)):
        for merge_steps in (0.0, 0.4):
            setup = BoardSetup(COREXY, firmware(), PEN, sizing=Sizing(merge_steps=merge_steps))
            program = [*prologue(setup), *encode([Lower(0.5, 0), Draw(motion, 0), Lift(0.1)], setup)]
            report = verify(program, setup.firmware, COREXY)
            apart = compare(report.strokes, [motion.sample(np.linspace(0, motion.total_s, 40000))[0]], 0.005)
            slower[name, merge_steps] = report.slowed_s / motion.total_s
            assert report.lowest_lead_s is not None and report.lowest_lead_s >= 0.99
            assert max(apart.drawn.max_mm, apart.wanted.max_mm) * 80 < (0.4 if name == "calm" else 0.75)
    assert slower["corners", 0.4] < 0.05 and slower["corners", 0.0] > 1.0 and slower["calm", 0.4] == 0.0


def test_only_what_is_too_dense_is_slowed_down() -> None:
    rng = np.random.default_rng(3)
    t = np.linspace(0, 8, 700)
    calm = np.column_stack((20 * t, 5 * np.sin(t)))
    scribble = calm[-1] + np.cumsum(rng.normal(0, 0.15, (400, 2)), axis=0)
    motion = spline_motion(np.vstack((np.zeros((1, 2)), calm, scribble, calm + scribble[-1])), 60)
    setup = BoardSetup(COREXY, firmware(), PEN, sizing=Sizing(least_lead_s=0.15))
    program = [*prologue(setup), *encode([Lower(0.1, 0), Draw(motion, 0), Lift(0.1)], setup)]
    said = [item for item in program if isinstance(item, Slowed)]
    report = verify(program, setup.firmware, COREXY)
    assert len(said) == 1 and said[0].lost_s == pytest.approx(report.pen_down_s - motion.total_s, abs=0.2)
    assert report.sendable and report.predicted_underruns == 0
    assert report.lowest_lead_s is not None and report.lowest_lead_s >= 0.15
    # Slowed as a whole as much as its worst it would take 6 s more than its 4.3; the scribble alone has to take 1.1 more.
    assert motion.total_s * 1.1 < report.pen_down_s < motion.total_s + 2.3
    apart = compare(report.strokes, [motion.sample(np.linspace(0, motion.total_s, 40000))[0]], 0.005)
    assert max(apart.drawn.max_mm, apart.wanted.max_mm) * 80 < 0.6


def test_slowing_down_changes_time_alone() -> None:
    t = np.linspace(0, 12, 600)
    borders = borders_of(spline_motion(np.column_stack((5 * t, 3 * np.sin(t))), 200), COREXY, np.zeros(2))
    need = np.ones(len(borders))
    need[300:320] = 2.5
    slower, stretch = slowed(borders, need, rises(borders))
    assert stretch[300:321].min() > 2.49 and stretch[0] == stretch[-1] == 1.0
    longer = slower.ticks / borders.ticks
    assert (longer[300:320] >= 2.49).all() and (longer[:200] == 1).all() and (longer[400:] == 1).all() and longer.min() == 1
    np.testing.assert_array_equal(slower.x, borders.x)
    one, other = at_every_tick(slower)[0], at_every_tick(borders)[0]
    assert compare([one @ (TO_MM * ONE_STEP)], [other @ (TO_MM * ONE_STEP)], 0.002).drawn.max_mm * 80 < 0.15
    assert accelerations(slower).max() < 1.6 * accelerations(borders).max()
    assert slowed(borders, np.ones(len(borders)), rises(borders))[0].ticks.tolist() == borders.ticks.tolist()


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10**6), ticks=st.integers(60, 500))
def test_slowing_down_never_speeds_up(seed: int, ticks: int) -> None:
    """A motor at the board's fastest would be told to step faster than it can."""
    rng = np.random.default_rng(seed)
    n = 60
    rate = np.full((n + 1, 2), 0.999 * ONE_STEP)
    x = np.concatenate((np.zeros((1, 2)), np.cumsum(np.full((n, 2), ticks * rate[0, 0]), axis=0)))
    borders = Borders(x, rate, np.full(n, ticks))
    need = np.where(rng.random(n) < 0.2, rng.uniform(1, 3, n), 1.0)
    slower, _ = slowed(borders, need, rises(borders) + 0.05)
    assert at_every_tick(slower)[1].max() <= 0.999 * (1 + 1 / ticks)


def test_a_piece_that_steps_too_fast_between_its_ends_is_found() -> None:
    x, v = np.array([[0.0, 0.0], [100.0, 50.0], [190.0, 100.0]]) * ONE_STEP, np.array([[0.98, 0.5], [0.98, 0.5], [0.9, 0.5]])
    assert too_fast(Borders(x, v * ONE_STEP, np.array([100, 97]))).tolist() == [True, False]


@pytest.mark.parametrize("lead_s", [0.2, 0.6, 1.0])
def test_the_lead_that_is_asked_for_is_kept_and_no_more_time_taken_than_it_needs(lead_s: float) -> None:
    """Corners 4 ms apart: as many pieces as are queued last less than half a second, however they are merged."""
    motion = corners(1500, 100)
    setup = BoardSetup(COREXY, firmware(), PEN, sizing=Sizing(least_lead_s=lead_s))
    report = verify([*prologue(setup), *encode([Lower(0.5, 0), Draw(motion, 0), Lift(0.1)], setup)], setup.firmware, COREXY)
    assert report.lowest_lead_s is not None and report.lowest_lead_s >= lead_s * 0.99
    plain = BoardSetup(COREXY, firmware(), PEN, sizing=Sizing(least_lead_s=0.01))
    lead = verify([*prologue(plain), *encode([Lower(0.5, 0), Draw(motion, 0), Lift(0.1)], plain)], plain.firmware, COREXY)
    assert lead.lowest_lead_s is not None
    assert report.slowed_s <= motion.total_s * max(lead_s * 1.1 / lead.lowest_lead_s - 1.0, 0.0)


@pytest.mark.parametrize("version", ["3.0.3", "2.8.1", "2.4.0"])
def test_parts_that_are_slowed_go_on_from_each_other(version: str) -> None:
    """A dense part between calm ones: the rate does not jump where they meet, and the board is still told in time."""
    rng = np.random.default_rng(3)
    t = np.linspace(0, 8, 700)
    calm = np.column_stack((20 * t, 5 * np.sin(t)))
    scribble = calm[-1] + np.cumsum(rng.normal(0, 0.15, (400, 2)), axis=0)
    motion = spline_motion(np.vstack((np.zeros((1, 2)), calm, scribble, calm + scribble[-1])), 60)
    setup = BoardSetup(COREXY, firmware(version), PEN)
    jumps, seconds = {}, {}
    for borders in ([], [600, 700, 900, 1110, 1300]):
        parts = in_parts(motion, borders)
        draws = [Draw(part, 0, part is parts[-1]) for part in parts]
        report = verify([*prologue(setup), *encode([Lower(0.1, 0), *draws, Lift(0.1)], setup)], setup.firmware, COREXY)
        assert report.sendable and report.predicted_underruns == 0
        jumps[len(parts)], seconds[len(parts)] = report.max_velocity_jump_mm_s, report.pen_down_s
        apart = compare(report.strokes, [motion.sample(np.linspace(0, motion.total_s, 40000))[0]], 0.005)
        assert max(apart.drawn.max_mm, apart.wanted.max_mm) * 80 < {"3": 0.75, "2": 4.0}[version[0]]
    # Firmware 2 slows each part by a factor of its own: shorter, and rougher only by what the lines and parabolas of the
    # less slowed parts are. (Without going on from each other's factor the rate jumps seven times as much.)
    assert jumps[6] <= jumps[1] * {"3": 1.1, "2": 2.2}[version[0]] + 0.5
    assert seconds[6] <= seconds[1] * 1.02 + 0.05


@pytest.mark.parametrize("version", ["3.0.3", "3.0.0"])
def test_the_lead_is_said_once_the_queue_has_been_full(version: str) -> None:
    setup = BoardSetup(COREXY, firmware(version), PEN)
    program = [*prologue(setup), *encode([Lower(0.1, 0), Draw(corners(900), 0), Lift(0.1)], setup)]
    report = verify(program, setup.firmware, COREXY)
    assert report.queue_depth == 30 and (report.lowest_lead_s or 0) > 0.3 and report.lowest_lead_at > 30


def test_short_strokes_leave_room_for_what_comes_after_them() -> None:
    """Strokes too short to fill the queue by themselves: each takes no more than its share of it."""
    actions: list[Action] = []
    here = np.zeros(2)
    for index in range(40):
        t = np.linspace(0, 1.5, 22)
        stroke = spline_motion(here + np.column_stack((4 * t, 2 * np.sin(2 * t))), 188)
        here = stroke.end_mm
        actions += [Lower(0.04, index), Draw(stroke, index), Lift(0.04)]
    setup = BoardSetup(COREXY, firmware(), PEN)
    report = verify([*prologue(setup), *encode(actions, setup)], setup.firmware, COREXY)
    # The abrupt ends of these strokes cannot be merged; without regard to what comes it would be 0.34.
    assert report.queue_filled and report.lowest_lead_s is not None and report.lowest_lead_s >= 0.7
    assert all(len(stroke) > 2 for stroke in report.strokes)
