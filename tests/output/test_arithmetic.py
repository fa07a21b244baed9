"""The exact arithmetic against the table of what the firmware did, and against a tick-by-tick register machine."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from output.ebb import arithmetic
from output.ebb.arithmetic import NeverEnds, State, execute
from output.ebb.commands import L3, LM, LT, SM, T3, Command
from output.ebb.commands_text import parse_as_sent

MOVES = Path(__file__).parents[1] / "data" / "ebb_moves_sample.jsonl"
ROWS = [json.loads(line) for line in MOVES.read_text().splitlines()]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: str(row["id"]))
def test_every_row_of_the_table_is_reproduced(row: dict) -> None:
    state, ticks, wall = State(), 0, 0
    for text, (one, two, acc1, acc2, took) in zip(row["cmds"], row["per"], strict=True):
        done = execute(parse_as_sent(text), state)
        state = done.state
        assert (*state.position, *state.acc, done.ticks) == (one, two, acc1, acc2, took), text
        ticks, wall = ticks + done.ticks, wall + done.ticks + done.dead_ticks
    assert [list(state.position), list(state.acc), ticks, wall] == [row["pos"], row["acc"], row["ticks"], row["wall"]]


class Registers:
    """One axis as the interrupt has it: 32-bit registers, one addition each per tick."""

    def __init__(self, position: int, acc: int, rate: int, accel: int, jerk: int) -> None:
        self.position, self.acc, self.rate, self.accel, self.jerk = position, acc, rate, accel, jerk

    def tick(self) -> bool:
        self.accel = self._wrap(self.accel + self.jerk)
        self.rate = self._wrap(self.rate + self.accel)
        acc = (self.acc + self.rate) & 0xFFFFFFFF
        self.acc = acc & 0x7FFFFFFF
        if acc >> 31:
            self.position += -1 if self.rate < 0 else 1
            return True
        return False

    @staticmethod
    def _wrap(value: int) -> int:
        return (value + (1 << 31)) % (1 << 32) - (1 << 31)


def _register(rate: int, accel: int, jerk: int, position: int, acc: int) -> Registers:
    start = Registers._wrap(rate - arithmetic.trunc_div(accel, 2) + arithmetic.trunc_div(jerk, 6))
    return Registers(position, acc, start, Registers._wrap(accel - jerk), jerk)


I32 = st.integers(-(2**31), 2**31 - 1)
SOME = st.one_of(I32, st.integers(-(10**6), 10**6), st.integers(-9, 9))
ACC = st.integers(0, 2**31 - 1)


@settings(max_examples=80, deadline=None, phases=(Phase.explicit, Phase.reuse, Phase.generate))
@given(st.integers(1, 300), st.tuples(SOME, SOME, SOME), st.tuples(SOME, SOME, SOME), st.tuples(ACC, ACC))
def test_timed_moves_are_the_registers(ticks: int, one: tuple, two: tuple, acc: tuple) -> None:
    done = execute(T3(ticks, *one, *two), State((5, -7), acc))
    for axis, values in enumerate((one, two)):
        machine = _register(*values, (5, -7)[axis], acc[axis])
        for _ in range(ticks):
            machine.tick()
        assert (done.state.position[axis], done.state.acc[axis]) == (machine.position, machine.acc)
    assert (done.ticks, done.dead_ticks) == (ticks, 1)


@settings(max_examples=80, deadline=None, phases=(Phase.explicit, Phase.reuse, Phase.generate))
@given(st.integers(1, 40), st.integers(-40, 40), SOME, SOME, ACC)
def test_stepped_moves_are_the_registers(steps1: int, steps2: int, rate: int, accel: int, acc: int) -> None:
    rates = (10**8, abs(rate) if steps2 < 0 else rate)
    command = LM(rates[0], steps1, 0, min(rates[1], 2**31 - 1), steps2, accel)
    try:
        done = execute(command, State((0, 0), (acc, acc)))
    except NeverEnds:
        # Only a rate that never is anything but 0, or one that wraps for an hour and a half.
        assert steps2
        return
    if done.ticks > 20000:
        return
    flip = -1 if steps2 < 0 else 1
    machine = _register(flip * command.rate2, Registers._wrap(flip * accel), 0, 0, acc)
    taken = ticks = 0
    while taken < abs(steps2):
        ticks += 1
        taken += machine.tick()
    assert (done.state.position[1], done.state.acc[1]) == (machine.position, machine.acc)
    assert done.ticks >= ticks


def test_a_move_that_never_ends_is_said() -> None:
    with pytest.raises(NeverEnds):
        execute(LM(0, -1, 0, 1000, 5, 0), State())
    with pytest.raises(NeverEnds):
        execute(L3(1000, 5, 0, 0, 0, 3, 0, 0), State())


@pytest.mark.parametrize(("ms", "steps"), [(1, 51), (2, 101)])
def test_a_request_beyond_50_khz_is_clamped_and_one_beyond_25_is_refused(ms: int, steps: int) -> None:
    assert execute(parse_as_sent(f"SM,{ms},{steps},0"), State()).ticks == steps + 1
    with pytest.raises(arithmetic.StepRateRefused):
        execute(parse_as_sent(f"SM,{ms},{steps - 10 * ms},0"), State())


def test_segments_join_where_the_axes_stop_at_different_times() -> None:
    commands: list[Command] = [LM(10**8, 12, 0, 10**8, -40, 500), SM(40, 25, -70), LT(300, 10**8, -5, -(10**7), 3)]
    state = State((3, 4), (77, 88))
    for command in commands:
        done = execute(command, state)
        assert sum(segment.ticks for segment in done.segments) == done.ticks
        last = done.segments[-1]
        for axis in (0, 1):
            end = last.phase[axis] + last.profile[axis].total(last.ticks)
            assert abs(end / 2**31 - done.state.position[axis]) <= 0.5
        state = done.state
