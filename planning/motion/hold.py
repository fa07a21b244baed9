"""Stopping in the middle of a motion, and going on again, without leaving its path: plan time is slowed down, not the path
changed.

The pen follows q(tau) = m(s(tau)), m being the motion and s plan time. With b(s) = (ds/dtau)^2, and primes for plan time in m:

    q'  = m' sqrt(b)      q'' = m'' b + m' b' / 2      q''' = sqrt(b) (m''' b + 1.5 m'' b' + m' b'' / 2)

Let V, A, J be the greatest |m'|, |m''|, |m'''| ahead, and b = 1 - delta (cosh(lambda s) - 1). Then |b'| and |b''| are at most
lambda and lambda^2 times (1 - b + delta), every bound is linear in b, and so it is enough that it holds at b = 1 and at b = 0:

    A + V lambda delta / 2 <= A_max                 J + (1.5 A lambda + V lambda^2 / 2) delta <= J_max
    V lambda (1 + delta) / 2 <= A_max               (1.5 A lambda + V lambda^2 / 2) (1 + delta) <= J_max

However full the motion uses its limits, there is a delta that is small enough; the slower it runs, the more of them is free.
The last part, from SLOW of full speed to rest, is an ordinary jerk-limited ramp. Speeding up is the same backwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planning.errors import ImpossiblePlan
from planning.motion import banded, spline
from planning.motion.limits import Limits
from planning.motion.path import Array, Ints
from planning.motion.plan import TICK_S, Motion, joined_motion, still

# Below this part of plan speed the stop is a plain ramp.
SLOW = 0.3
# The pen may leave the motion's own curve by this much while it is slowed down.
FIT_MM = 0.002
# No piece longer than this, nor than a twentieth of the whole, so that the fit is that good; none shorter.
LONGEST_S, SHORTEST_S, LEAST_PIECES = 0.006, 0.002, 20
# What lies this far ahead is looked at when choosing how hard to brake.
HORIZON_S = 2.0
# Each attempt that breaks a limit is followed by a gentler one.
GENTLER, ATTEMPTS = 0.85, 16
# Where the motion is too close to its limits to brake at once, it runs on this long first.
DELAYS_S = (0.0, 0.01, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.5, 0.8)
STOP_ATTEMPTS = 10
# Slower than this (mm/s) is at rest.
MOVING_MM_S = 1e-6


@dataclass(frozen=True, eq=False, slots=True)
class _Ramp:
    """From full plan speed to rest: clock and plan time passed (m,), both from 0, and how gentle it had to be (1: not)."""

    tau_s: Array
    plan_s: Array
    gentle: float


def stop_on_path(motion: Motion, from_s: float, limits: Limits) -> tuple[Motion, float]:
    """Come to rest on the motion's own path, starting from its state at plan time `from_s` (rounded up to a tick).

    Returns the stopping motion, which starts moving, and the plan time it comes to rest at. Keeps `limits` wherever the
    motion itself does. Near its end the motion just runs out. Raises ValueError for a time outside the motion, or when it
    would run out moving: the part of the stroke that follows must be joined to it then.
    """
    begin = _tick_up(motion, from_s)
    total = motion.total_s
    for delay in DELAYS_S:
        start = begin + np.ceil(delay / TICK_S) * TICK_S
        gentle = 1.0
        for _ in range(STOP_ATTEMPTS):
            ramp = _ramp(motion, start, min(total, start + HORIZON_S), limits, gentle)
            if ramp is None or start + ramp.plan_s[-1] >= total:
                return run_out(motion, begin)
            duration = int(np.ceil(ramp.tau_s[-1] / TICK_S))
            knots = _knots(motion, ramp.tau_s, start + ramp.plan_s, duration)
            at = start + np.interp(knots * TICK_S, ramp.tau_s, ramp.plan_s)
            found = _fitted(motion, knots, at, limits)
            if found is not None:
                return _joined(_part(motion, begin, start), found), start + float(ramp.plan_s[-1])
            gentle = ramp.gentle * GENTLER
    return run_out(motion, begin)


def stop_on_line(motion: Motion, from_s: float, limits: Limits) -> Motion | None:
    """Come to rest on a straight motion's own line, from its state at plan time `from_s` (rounded up to a tick), in the least
    time that `limits`, along it, allow. No pieces where it has not begun; None where the motion ends before that.

    The acceleration goes from a0 to p within t1, stays for t2, and goes back to 0 within t3. Whole ticks of at least the
    least times only lower p and the jerk:

        p = -(v0 + a0 t1 / 2) / (t1 / 2 + t2 + t3 / 2)
    """
    begin = _tick_up(motion, from_s)
    q, v, a, _ = (x[0] for x in motion.sample(np.array([begin])))
    left_mm = float(np.hypot(*(motion.end_mm - q)))
    if begin >= motion.total_s - TICK_S / 2.0 or left_mm == 0.0:
        return None
    if begin < TICK_S / 2.0:
        return still(q)
    along = (motion.end_mm - q) / left_mm
    v0, a0 = float(v @ along), float(a @ along)
    most = min(limits.acceleration_mm_s2, float(np.sqrt(max(limits.jerk_mm_s3 * v0 + a0**2 / 2.0, 0.0))))
    if most <= -a0 or v0 <= 0.0:
        return None
    least_s = np.array([(a0 + most) / limits.jerk_mm_s3, 0.0, most / limits.jerk_mm_s3])
    least_s[1] = max((v0 + (a0 - most) * least_s[0] / 2.0 - most * least_s[2] / 2.0) / most, 0.0)
    t = np.maximum(np.ceil(least_s / TICK_S - 1e-6), [1.0, 0.0, 1.0]) * TICK_S
    peak = -(v0 + a0 * t[0] / 2.0) / (t[0] / 2.0 + t[1] + t[2] / 2.0)
    jerk, acceleration = np.array([(peak - a0) / t[0], 0.0, -peak / t[2]]), np.array([a0, peak, peak])
    gained = acceleration * t + jerk * t**2 / 2.0
    speed = v0 + np.concatenate(([0.0], np.cumsum(gained)[:2]))
    way_mm = np.cumsum(speed * t + acceleration * t**2 / 2.0 + jerk * t**3 / 6.0)
    if way_mm[-1] >= left_mm:
        return None
    at_mm = np.concatenate(([0.0], way_mm))[:, None] * along + q
    some = t > 0.0
    speed_mm_s, acceleration_mm_s2, jerk_mm_s3 = (x[some, None] * along for x in (speed, acceleration, jerk))
    return Motion(t[some], at_mm[:-1][some], speed_mm_s, acceleration_mm_s2, jerk_mm_s3, at_mm[-1])


def run_out(motion: Motion, from_s: float) -> tuple[Motion, float]:
    """What is left of the motion from plan time `from_s` (rounded up to a tick) on; it must end at rest. As `stop_on_path`."""
    begin = _tick_up(motion, from_s)
    _end_at_rest(motion)
    return _part(motion, begin, motion.total_s), motion.total_s


def _end_at_rest(motion: Motion) -> None:
    if len(motion) and np.abs(motion.sample(np.array([motion.total_s]))[1]).max() > MOVING_MM_S:
        raise ValueError("the motion is still moving at its end: join the part of the stroke that follows to it")


def resume_on_path(motion: Motion, at_s: float, limits: Limits) -> Motion:
    """From rest at the motion's point of plan time `at_s`, speed up along its path, join it exactly and run it to its end.

    Raises ValueError for a time outside the motion, or one so near the end of a motion that ends moving that the start would
    run into what follows; ImpossiblePlan when no start within `limits` is found.
    """
    total = motion.total_s
    if not 0.0 <= at_s <= total + TICK_S:
        raise ValueError(f"plan time {at_s} s is outside the motion's {total:.6g} s")
    if at_s >= total - 1e-9:
        return _part(motion, total, total)
    gentle = 1.0
    for _ in range(ATTEMPTS):
        ramp = _ramp(motion, at_s, min(total, at_s + HORIZON_S), limits, gentle)
        if ramp is None:
            gentle *= GENTLER
            continue
        gentle = ramp.gentle * GENTLER
        # The ramp backwards: rest first, plan speed last.
        tau, plan = ramp.tau_s[-1] - ramp.tau_s[::-1], ramp.plan_s[-1] - ramp.plan_s[::-1]
        join = _tick_up(motion, min(at_s + float(plan[-1]), total))
        tau = np.append(tau, tau[-1] + max(join - at_s - plan[-1], 0.0))
        plan = np.append(plan, max(join - at_s, plan[-1]))
        if join >= total - 1e-9:
            # The motion ends before full speed: it may be cut off anywhere, being at rest there in any case.
            _end_at_rest(motion)
            end = float(np.interp(total - at_s, plan, tau))
            tau, plan = np.append(tau[tau < end], end), np.append(plan[tau < end], total - at_s)
            join = total
        duration = int(np.ceil(tau[-1] / TICK_S))
        wait = duration * TICK_S - tau[-1]
        knots = _knots(motion, tau + wait, at_s + plan, duration)
        at = at_s + np.interp(knots * TICK_S - wait, tau, plan)
        found = _fitted(motion, knots, at, limits, from_rest=True)
        if found is not None:
            return _joined(found, _part(motion, join, total))
    raise ImpossiblePlan(
        f"no start from rest at plan time {at_s:.6g} s of a {total:.6g} s motion keeps its limits; "
        "lift the pen and redraw the stroke"
    )


def _tick_up(motion: Motion, at_s: float) -> float:
    total = motion.total_s
    if not 0.0 <= at_s <= total + TICK_S:
        raise ValueError(f"plan time {at_s} s is outside the motion's {total:.6g} s")
    return min(float(np.ceil(at_s / TICK_S - 1e-6)) * TICK_S, total)


def _ramp(motion: Motion, low_s: float, high_s: float, limits: Limits, gentle: float) -> _Ramp | None:
    """The quickest of the ramps that suit what the motion does between these plan times; None when it does nothing there."""
    starts = np.concatenate(([0.0], np.cumsum(motion.duration_s)))
    times = np.unique(np.concatenate((np.linspace(low_s, high_s, 200), starts[(starts > low_s) & (starts < high_s)])))
    _, v, a, j = motion.sample(times)
    speed, accel, jerk = (float(np.hypot(*x.T).max()) for x in (v, a, j))
    if speed == 0.0:
        return None
    most_a, most_j = limits.acceleration_mm_s2, limits.jerk_mm_s3
    free_a, free_j = max(most_a - accel, 1e-4 * most_a), max(most_j - jerk, 1e-4 * most_j)
    # At b = 0 the two bounds with delta <= 1; a little below the root, so that delta fits in.
    root = (-1.5 * accel + np.sqrt(2.25 * accel**2 + 2.0 * speed * most_j)) / speed
    top = min(2.0 * most_a / speed, float(root))
    best: tuple[float, float, float] | None = None
    for share in np.linspace(0.3, 0.999, 24):
        rate = share * top
        cost = 1.5 * accel * rate + 0.5 * speed * rate**2
        delta = min(free_a / (0.5 * speed * rate), free_j / cost, most_a / (0.5 * speed * rate) - 1.0, most_j / cost - 1.0)
        if delta > 0.0:
            length = float(np.arccosh(1.0 + (1.0 - SLOW**2) / delta)) / rate
            if best is None or length < best[0]:
                best = (length, delta, rate)
    if best is None:
        return None
    _, delta, rate = best
    rate *= gentle
    length = float(np.arccosh(1.0 + (1.0 - SLOW**2) / delta)) / rate
    s = np.linspace(0.0, length, max(200, int(length / 2e-5)))
    b = 1.0 - delta * (np.cosh(rate * s) - 1.0)
    tau = np.concatenate(([0.0], np.cumsum(np.diff(s) * 2.0 / (np.sqrt(b[1:]) + np.sqrt(b[:-1])))))
    # From SLOW: keep this deceleration, then let it go at a steady rate, so that both reach zero together.
    fall = 0.5 * delta * rate * float(np.sinh(rate * length))
    ease = gentle * (most_j - SLOW**3 * jerk - 3.0 * accel * SLOW * fall) / speed
    if ease <= 0.0 or fall**2 / (2.0 * ease) > SLOW:
        return _ramp(motion, low_s, high_s, limits, gentle * GENTLER) if gentle > 1e-3 else None
    hold, let_go = (SLOW - fall**2 / (2.0 * ease)) / fall, fall / ease
    t = np.linspace(0.0, hold + let_go, 1000)
    late = np.maximum(t - hold, 0.0)
    way = SLOW * t - fall * t**2 / 2.0 + ease * late**3 / 6.0
    return _Ramp(np.concatenate((tau, tau[-1] + t[1:])), np.concatenate((s, s[-1] + way[1:])), gentle)


def _knots(motion: Motion, tau_s: Array, plan_s: Array, duration: int) -> Ints:
    """Knots in ticks: where the motion's own fall, so that its jumps of jerk stay at knots, and between where they are far

    apart.
    """
    starts = np.concatenate(([0.0], np.cumsum(motion.duration_s)))
    own = starts[(starts > plan_s[0]) & (starts < plan_s[-1])]
    at = np.rint(np.interp(own, plan_s, tau_s) / TICK_S)
    shortest = int(SHORTEST_S / TICK_S)
    kept = [0]
    for tick in at.astype(np.int64):
        if tick - kept[-1] >= shortest and duration - tick >= shortest:
            kept.append(int(tick))
    kept.append(duration)
    longest = max(min(int(LONGEST_S / TICK_S), duration // LEAST_PIECES), shortest)
    out = [np.zeros(1, dtype=np.int64)]
    for low, high in pairwise(kept):
        parts = max(1, -(-(high - low) // longest), -(-4 // (len(kept) - 1)))
        out.append(np.rint(np.linspace(low, high, parts + 1)[1:]).astype(np.int64))
    return np.unique(np.concatenate(out))


def _fitted(motion: Motion, knots: Ints, at_s: Array, limits: Limits, from_rest: bool = False) -> Motion | None:
    """The C2 piecewise cubic through the motion's points at plan times `at_s`, its ends exact; None when it breaks a limit or

    the path.
    """
    n = len(knots) - 1
    if n < 6:
        knots = np.unique(np.rint(np.linspace(knots[0], knots[-1], 7)).astype(np.int64))
        if len(knots) < 7:
            return None
        old = np.linspace(0.0, 1.0, len(at_s))
        at_s = np.interp(np.linspace(0.0, 1.0, 7), old, at_s)
        n = 6
    spacing = np.diff(knots) * TICK_S
    lay = spline.layout(spacing.astype(np.float64), np.array([n]), float(spacing.mean()))
    q, v, a, _ = motion.sample(at_s)
    zero = np.zeros((1, 2))
    start = (q[:1], zero, zero) if from_rest else (q[:1], v[:1], a[:1])
    end = (q[-1:], v[-1:], a[-1:]) if from_rest else (q[-1:], zero, zero)
    head = spline.control_of_state(lay, np.array([0]), *start)
    tail = spline.control_of_state(lay, np.array([n]), *end)
    fixed = banded.Fixed(np.array([0, 1, 2, n, n + 1, n + 2]), np.concatenate(head + tail))
    weight = np.where(lay.is_knot, 1.0, 0.0)
    target = np.concatenate((q, np.zeros((2, 2))))
    none = banded.Anchors(np.zeros(0, dtype=np.int64), np.zeros((4, 0)), np.zeros((0, 2)), np.zeros((0, 3)))
    zeros = np.zeros(n + 3)
    control = banded.solve(lay, zeros, zeros, (weight, zeros, weight), target, none, np.zeros(0), fixed)
    position, velocity, acceleration = (x[: n + 1] for x in lay.knot_values(control))
    position[[0, -1]] = np.concatenate((start[0], end[0]))
    velocity[[0, -1]] = np.concatenate((start[1], end[1]))
    acceleration[[0, -1]] = np.concatenate((start[2], end[2]))
    jerk = np.diff(acceleration, axis=0) / spacing[:, None]
    if np.hypot(*(position - q).T).max() > FIT_MM:
        return None
    if np.hypot(*acceleration.T).max() > limits.acceleration_mm_s2 or np.hypot(*jerk.T).max() > limits.jerk_mm_s3:
        return None
    if np.hypot(*velocity.T).max() > limits.speed_mm_s:
        return None
    return Motion(spacing, position[:-1].copy(), velocity[:-1].copy(), acceleration[:-1].copy(), jerk, position[-1].copy())


def _part(motion: Motion, from_s: float, to_s: float) -> Motion:
    """The motion between two plan times, whole numbers of ticks; moving at both ends where it moves there."""
    ends = np.cumsum(motion.duration_s)
    low = int(np.searchsorted(ends, from_s + 0.25 * TICK_S, side="right"))
    high = int(np.searchsorted(ends, to_s - 0.25 * TICK_S, side="left")) + 1 if to_s > from_s + 0.25 * TICK_S else low
    whole = to_s >= motion.total_s - 0.25 * TICK_S
    end = motion.end_mm if whole else motion.sample(np.array([to_s]))[0][0]
    duration = motion.duration_s[low:high].copy()
    states = (motion.position_mm, motion.velocity_mm_s, motion.acceleration_mm_s2)
    position, velocity, acceleration = (x[low:high].copy() for x in states)
    begun = float(from_s - (ends[low - 1] if low else 0.0))
    if len(duration) and begun > 0.25 * TICK_S:
        duration[0] = np.rint((duration[0] - begun) / TICK_S) * TICK_S
        q, v, a, _ = motion.sample(np.array([from_s]))
        position[0], velocity[0], acceleration[0] = q[0], v[0], a[0]
    if len(duration) and not whole:
        duration[-1] = np.rint((duration[-1] - (ends[high - 1] - to_s)) / TICK_S) * TICK_S
    return Motion(duration, position, velocity, acceleration, motion.jerk_mm_s3[low:high], end)


def _joined(first: Motion, second: Motion) -> Motion:
    """Two motions, the second starting where and as the first ends; either may have no pieces."""
    return joined_motion([first, second]) if len(first) else second
