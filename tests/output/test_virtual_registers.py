"""The closed forms of the step interrupt against the interrupt itself, one tick after another."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from output.ebb.virtual.motion_commands import rate_for, signed_ramp
from output.ebb.virtual.registers import Ramp, int32, ticks_to_take

int32s = st.integers(-(2**31), 2**31 - 1)
near_zero = st.integers(-3_000_000, 3_000_000)
registers = st.one_of(int32s, near_zero, st.sampled_from([0, 1, -1, 2**31 - 1, -(2**31)]))
accumulators = st.integers(0, 2**31 - 1)


class Interrupt:
    """The registers of one axis and what one tick does to them, as the reference says it in words."""

    def __init__(self, rate: int, accel: int, jerk: int, acc: int) -> None:
        half = abs(accel) // 2 * (1 if accel > 0 else -1)
        sixth = abs(jerk) // 6 * (1 if jerk > 0 else -1)
        self.rate = int32(rate - half + sixth)
        self.accel = int32(accel - jerk)
        self.jerk = jerk
        self.acc = acc
        self.position = 0
        self.steps = 0

    def tick(self) -> None:
        self.accel = int32(self.accel + self.jerk)
        self.rate = int32(self.rate + self.accel)
        self.acc = (self.acc + self.rate) & 0xFFFFFFFF
        if self.acc & 0x80000000:
            self.acc &= 0x7FFFFFFF
            self.steps += 1
            self.position += -1 if self.rate < 0 else 1


@given(registers, registers, registers, accumulators, st.integers(1, 700))
@settings(max_examples=150, deadline=None)
def test_totals_are_what_the_ticks_add_up_to(rate: int, accel: int, jerk: int, acc: int, ticks: int) -> None:
    interrupt, ramp = Interrupt(rate, accel, jerk, acc), signed_ramp(rate, accel, jerk)
    for t in range(1, ticks + 1):
        interrupt.tick()
        assert ramp.rate(t) == interrupt.rate
    phase = acc + ramp.total(ticks)
    assert (phase >> 31, phase & 0x7FFFFFFF) == (interrupt.position, interrupt.acc)


@given(registers, st.one_of(near_zero, int32s), st.one_of(st.just(0), near_zero), accumulators, st.integers(1, 60))
@settings(max_examples=200, deadline=None)
def test_a_move_by_steps_ends_at_the_tick_of_its_last_step(rate: int, accel: int, jerk: int, acc: int, steps: int) -> None:
    interrupt, ramp = Interrupt(rate, accel, jerk, acc), signed_ramp(rate, accel, jerk)
    ticks = 0
    while interrupt.steps < steps and ticks < 3000:
        interrupt.tick()
        ticks += 1
    found = ticks_to_take(steps, ramp, acc)
    if interrupt.steps == steps:
        assert found == ticks
    else:
        assert found is None or found > ticks


@given(registers, registers, registers, st.integers(0, 500), st.integers(1, 500))
@settings(max_examples=100, deadline=None)
def test_a_ramp_can_be_cut_anywhere(rate: int, accel: int, jerk: int, before: int, after: int) -> None:
    ramp = Ramp(rate, accel, jerk)
    rest = ramp.after(before)
    assert ramp.total(before) + rest.total(after) == ramp.total(before + after)


@given(st.integers(0, 2**31), st.integers(1, 2**31 - 1))
@settings(max_examples=200, deadline=None)
def test_the_rate_of_sm_is_never_above_and_hardly_below_the_exact_one(steps: int, duration_ms: int) -> None:
    exact = steps * 2**31 / (25 * duration_ms)
    rate = rate_for(steps, duration_ms)
    if exact < 2**32 * 0.999:
        assert exact * (1 - 4e-7) - 1 <= rate <= exact * (1 + 2e-7) + 1
