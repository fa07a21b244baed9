"""Time-optimal-like motion inside the tolerance tube around a path: the draw planner's heart.

x(t), y(t) is one cubic B-spline in time per stroke, so that jerk is constant on each knot interval and speed and acceleration
are continuous. A speed profile along the path says how long the stroke must last and where each knot should be. Reweighted
least squares (Lawson's multiplicative weights) then levels jerk, acceleration and distance to the path, each over its own
bound, so that every place uses exactly the part of the tube that it needs. Where the levelled fit still breaks a bound, the
profile is slowed down there, and the fit is made again. Many strokes are solved in one banded system; they do not touch each
other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from planning.motion import banded, spline
from planning.motion.limits import Kinematics, Limits
from planning.motion.path import Array, Ints, Mask, PathSet, distance_to_path, path_set
from planning.motion.plan import TICK_S
from planning.motion.speed import CORNER_SLOWNESS, Grid, fastest, make_grid, speed_caps

# The fit aims below the limits by these parts, and is taken when it is within the limits themselves (less rounding).
AIM_SPEED, AIM_ACCELERATION, AIM_JERK, AIM_TOLERANCE = 0.985, 0.985, 0.97, 0.94
TAKE = 0.9998
# Levelling aims a little lower still, so that the last few places come down too.
LEVEL, LEVEL_TOLERANCE = 0.975, 0.92
STAGES = 24
FIRST_ROUNDS, ROUNDS = 16, 12
FEWEST_INTERVALS = 6
TANGENTIAL_WEIGHT = 0.05
# Samples in each piece when the distance to the path is verified.
SAMPLES = 4


@dataclass(frozen=True, eq=False, slots=True)
class Section:
    """A path to follow, or the rest of one: from `state` (position, velocity, acceleration, (3, 2)) at `from_mm` along it, to
    rest at its end.

    `points_mm` (n, 2) without repeated neighbours, n >= 2; `corners` (n,) or None. A `state` of None starts at rest at the
    first point. `slack_mm` is kept free of the tolerance (what thinning the vertices may have cost).
    """

    points_mm: Array
    corners: Mask | None = None
    state: Array | None = None
    from_mm: float = 0.0
    slack_mm: float = 0.0


@dataclass(frozen=True, eq=False, slots=True)
class Fit:
    """A motion found for a section: whole ticks of each piece (n,), states at the n + 1 knots, and how far along the path

    each knot is.
    """

    ticks: Ints
    position_mm: Array
    velocity_mm_s: Array
    acceleration_mm_s2: Array
    along_mm: Array

    def upto(self, knot: int, before_mm: float) -> Fit:
        """The part before `knot`, with `before_mm` added to how far along it is."""
        return Fit(self.ticks[:knot], self.position_mm[: knot + 1], self.velocity_mm_s[: knot + 1],
                   self.acceleration_mm_s2[: knot + 1], self.along_mm[: knot + 1] + before_mm)  # fmt: skip


@dataclass(frozen=True, eq=False, slots=True)
class Tuning:
    """What a retry may change: knot spacing, and how much of the speed limit to use at first."""

    spacing_s: float
    speed_share: float = 1.0


def knot_spacing_s(limits: Limits) -> float:
    """The knot interval: short beside the time A / J that acceleration takes to build, and long enough for the board."""
    return float(np.clip(0.3 * limits.acceleration_mm_s2 / limits.jerk_mm_s3, 0.005, 0.010))


def fit_sections(
    sections: Sequence[Section], limits: Limits, kinematics: Kinematics, tuning: Tuning | None = None
) -> list[Fit | None]:
    """A motion for each section, within `limits` at every instant; None where none was found in STAGES rounds of slowing

    down.
    """
    if not sections:
        return []
    return _Solver(sections, limits, kinematics, tuning or Tuning(knot_spacing_s(limits))).run()


@dataclass(eq=False, slots=True)
class _Rows:
    """One stage's system: per-row arrays over the blocks still unsolved. `blocks` are their indices in the solver."""

    blocks: Ints
    lay: spline.Layout
    spacing_ticks: Ints
    s: Array
    path: Ints
    target: Array
    tangent: Array
    room: Array
    weights: Array
    anchors: banded.Anchors
    anchor_weight: Array
    anchor_block: Ints
    anchor_room: Array
    fixed: banded.Fixed


class _Solver:
    def __init__(self, sections: Sequence[Section], limits: Limits, kinematics: Kinematics, tuning: Tuning) -> None:
        self.sections = sections
        self.limits = limits
        self.kinematics = kinematics
        self.speed = AIM_SPEED * limits.speed_mm_s
        self.accel = AIM_ACCELERATION * limits.acceleration_mm_s2
        self.jerk = AIM_JERK * limits.jerk_mm_s3
        self.tolerance = AIM_TOLERANCE * limits.tolerance_mm
        self.slack = np.array([x.slack_mm for x in sections])
        self.ramp_s = self.accel / self.jerk
        self.spacing_s = tuning.spacing_s
        self.window_s = max(self.ramp_s, 2.0 * tuning.spacing_s)
        self.paths: PathSet = path_set([x.points_mm for x in sections], [x.corners for x in sections], limits.tolerance_mm)
        aim = Limits(self.speed * tuning.speed_share, self.accel, self.jerk, self.tolerance)
        vertex_cap, segment_cap = speed_caps(self.paths, aim, kinematics, self.window_s)
        self.start_s = self.paths.s_mm[self.paths.first] + np.array([x.from_mm for x in sections])
        grid = make_grid(self.paths, vertex_cap, segment_cap, aim, self.window_s)
        self.moving = np.array([x.state is not None for x in sections])
        self.states = np.stack([x.state if x.state is not None else _rest_at(x.points_mm[0]) for x in sections])
        self.end_states = np.stack([_rest_at(x.points_mm[-1]) for x in sections])
        self.grid = self._started(grid)
        self.slow = self._first_slowness()
        self.results: list[Fit | None] = [None] * len(sections)
        self.profile_speed = np.zeros(0)

    def _started(self, grid: Grid) -> Grid:
        """The grid with what lies before a section's start cut off and the start's own speed as its cap."""
        if not self.moving.any():
            return grid
        s = np.concatenate((self.start_s[self.moving], grid.s_mm))
        path = np.concatenate((np.flatnonzero(self.moving), grid.path))
        speed = np.hypot(*self.states[self.moving, 1].T)
        cap = np.concatenate((speed, grid.cap_mm_s))
        curvature = np.concatenate((np.interp(self.start_s[self.moving], grid.s_mm, grid.curvature), grid.curvature))
        new = np.zeros(len(s), dtype=np.bool_)
        new[: int(self.moving.sum())] = True
        keep = new | (s > self.start_s[path] + 1e-6) | ~self.moving[path]
        order = np.argsort(s[keep], kind="stable")
        s, path, cap, curvature = (x[keep][order] for x in (s, path, cap, curvature))
        first = np.searchsorted(path, np.arange(len(self.sections)), side="left")
        last = np.searchsorted(path, np.arange(len(self.sections)), side="right") - 1
        return Grid(s, path, cap, curvature, first, last)

    def _first_slowness(self) -> Array:
        """A little slowness around corners, where it will be needed in any case, in terms of the time they take at the caps."""
        grid, paths = self.grid, self.paths
        slow = np.zeros(len(grid.s_mm))
        corners = np.flatnonzero(paths.sharp)
        if not len(corners):
            return slow
        speed = fastest(grid, grid.cap_mm_s, np.full(len(grid.s_mm), self.accel))
        time = _clock(grid, speed)
        at = np.interp(paths.s_mm[corners], grid.s_mm, time)
        amount = CORNER_SLOWNESS * np.minimum(1.0, np.abs(paths.turn_rad[corners]) / 0.7)
        for near in (np.searchsorted(at, time) - 1, np.searchsorted(at, time)):
            corner = np.clip(near, 0, len(at) - 1)
            shape = np.clip(1.5 - np.abs(time - at[corner]) / (0.7 * self.window_s), 0.0, 1.0)
            same = paths.path[corners[corner]] == grid.path
            slow = np.maximum(slow, np.where(same, amount[corner] * shape, 0.0))
        return slow

    # --- one stage -------------------------------------------------------------------------------------------------

    def run(self) -> list[Fit | None]:
        blocks = np.arange(len(self.sections))
        remembered: tuple[Array, Array] | None = None
        for stage in range(STAGES):
            rows = self._rows(blocks, remembered)
            worst_s, worst, remembered = self._level(rows, FIRST_ROUNDS if stage == 0 else ROUNDS)
            blocks = np.array([b for b in blocks if self.results[b] is None], dtype=np.int64)
            if not len(blocks):
                break
            self._slow_down(stage, worst_s, worst, blocks)
        return self.results

    def _rows(self, blocks: Ints, remembered: tuple[Array, Array] | None) -> _Rows:
        grid = self.grid if len(blocks) == len(self.sections) else _sub_grid(self.grid, blocks)
        slow = self.slow if len(blocks) == len(self.sections) else self.slow[np.isin(self.grid.path, blocks)]
        factor = np.exp(-slow)
        cap = grid.cap_mm_s * factor
        moving_first = grid.first[self.moving[blocks]]
        cap[moving_first] = grid.cap_mm_s[moving_first]
        speed = fastest(grid, cap, self.accel * factor * factor)
        time = _clock(grid, speed)
        start, total = time[grid.first], time[grid.last] - time[grid.first]
        rests = 2.0 - self.moving[blocks]
        wanted = 1.003 * total + 0.5 * self.ramp_s * rests
        intervals, ticks = _knots(wanted, self.spacing_s)
        lay = spline.layout(np.repeat(ticks * TICK_S, intervals).astype(np.float64), intervals, self.spacing_s)
        # At a rest the spline lags behind the profile by half the ramp; at a moving start it does not.
        last_knot = lay.time_s[lay.first + intervals]
        head = np.where(self.moving[blocks], 0.0, (last_knot - total) / 2.0)
        stretch = np.where(self.moving[blocks], (last_knot - 0.5 * self.ramp_s) / np.maximum(total, 1e-9), 1.0)
        t = np.clip((lay.time_s - head[lay.block]) / stretch[lay.block], 0.0, total[lay.block]) + start[lay.block]
        s = _place(grid, speed, time, t, lay.block)
        path = blocks[lay.block]
        target, tangent = self.paths.curve(s, path)
        bulge = self.paths.bulge_mm[self.paths.segment(s, path)]
        room = np.maximum(self.tolerance - bulge - self.slack[path], 0.3 * self.tolerance)
        anchors, anchor_block, anchor_room = self._anchors(grid, time, start, head, stretch, lay, blocks)
        if remembered is None:
            weights = np.tile(np.array([[0.0], [-2.0], [-2.0]]), (1, len(s)))
        else:
            # Weights must be mostly forgotten from stage to stage, or the levelling never settles.
            weights = 0.25 * np.stack([np.interp(s, remembered[0], w) for w in remembered[1]])
        return _Rows(blocks, lay, ticks, s, path, target, tangent, room, weights, anchors, np.full(len(anchors.row), 2.0),
                     anchor_block, anchor_room, self._fixed(lay, blocks))  # fmt: skip

    def _fixed(self, lay: spline.Layout, blocks: Ints) -> banded.Fixed:
        start, end = self.states[blocks], self.end_states[blocks]
        last = lay.first + lay.intervals
        head = spline.control_of_state(lay, lay.first, start[:, 0], start[:, 1], start[:, 2])
        tail = spline.control_of_state(lay, last, end[:, 0], end[:, 1], end[:, 2])
        rows = np.concatenate([lay.first + k for k in range(3)] + [last + k for k in range(3)])
        return banded.Fixed(rows, np.concatenate(head + tail))

    def _anchors(
        self, grid: Grid, time: Array, start: Array, head: Array, stretch: Array, lay: spline.Layout, blocks: Ints
    ) -> tuple[banded.Anchors, Ints, Array]:
        """The corners that the pen must come near at their own time: sideways, or from all sides where it nearly turns back."""
        paths = self.paths
        local = np.full(len(self.sections), -1)
        local[blocks] = np.arange(len(blocks))
        corner = np.flatnonzero(paths.sharp & (local[paths.path] >= 0) & (paths.s_mm > self.start_s[paths.path] + 1e-6))
        block = local[paths.path[corner]]
        t = np.interp(paths.s_mm[corner], grid.s_mm, time) - start[block]
        t = t * stretch[block] + head[block]
        offset = np.concatenate(([0.0], np.cumsum(lay.time_s[lay.first + lay.intervals] + 1.0)))[:-1]
        knot_time = lay.time_s + offset[lay.block]
        knot_time[~lay.is_interval] = np.inf
        knot_time = np.minimum.accumulate(knot_time[::-1])[::-1]
        row = np.searchsorted(knot_time, t + offset[block], side="right") - 1
        row = np.clip(row, lay.first[block], lay.first[block] + lay.intervals[block] - 1)
        after = np.clip(t - lay.time_s[row], 0.0, lay.spacing_s[row])
        unit = np.diff(paths.point_mm, axis=0) / paths.length_mm[:, None]
        along = unit[corner - 1] + unit[corner]
        norm = np.hypot(along[:, 0], along[:, 1])
        along = along / np.maximum(norm, 1e-9)[:, None]
        across = np.stack((-along[:, 1], along[:, 0]), axis=-1)
        around = np.abs(paths.turn_rad[corner]) > np.radians(100.0)
        metric = np.stack((across[:, 0] ** 2, across[:, 0] * across[:, 1], across[:, 1] ** 2), axis=-1)
        metric[around] = (1.0, 0.0, 1.0)
        metric /= self.tolerance**2
        found = banded.Anchors(row, spline.basis_at(lay, row, after), paths.point_mm[corner], metric)
        return found, block, np.full(len(row), 1.0)

    def _level(self, rows: _Rows, rounds: int) -> tuple[Array, Array, tuple[Array, Array]]:
        """Reweight until every block is taken or the rounds are over. Returns s and how far over its bounds each knot is at

        best.
        """
        best = np.full(len(rows.blocks), np.inf)
        over = np.ones(len(rows.s))
        for _ in range(rounds):
            control = self._solve(rows)
            ratio, anchor_ratio, local, states = self._ratios(rows, control)
            score = np.maximum.reduceat(local, rows.lay.first)
            if len(anchor_ratio):
                np.maximum.at(score, rows.anchor_block, anchor_ratio**0.6)
            better = score < best
            best = np.minimum(best, score)
            over = np.where(better[rows.lay.block], local, over)
            ready = self._within(rows, ratio, states)
            done = np.zeros(len(rows.blocks), dtype=np.bool_)
            if ready.any():
                done = self._take(rows, ready, states, over)
            self._reweigh(rows, ratio, anchor_ratio)
            if done.all():
                break
            if done.any():
                keep = ~done
                over = over[keep[rows.lay.block]]
                best = best[keep]
                rows = _kept(rows, keep)
        valid = rows.lay.is_knot
        return rows.s[valid], over[valid], (rows.s[valid], rows.weights[:, valid])

    def _solve(self, rows: _Rows) -> Array:
        lay = rows.lay
        weight = np.exp(rows.weights)
        jerk = np.where(lay.is_interval, weight[0], 0.0) / self.jerk**2
        acceleration = np.where(lay.is_knot, weight[1], 0.0) / self.accel**2
        lateral = np.where(lay.is_knot, weight[2], 0.0) / self.tolerance**2
        along = np.where(lay.is_knot, TANGENTIAL_WEIGHT, 0.0) / self.tolerance**2
        tx, ty = rows.tangent[:, 0], rows.tangent[:, 1]
        difference = along - lateral
        metric = (lateral + difference * tx * tx, difference * tx * ty, lateral + difference * ty * ty)
        return banded.solve(lay, jerk, acceleration, metric, rows.target, rows.anchors, np.exp(rows.anchor_weight), rows.fixed)

    def _ratios(self, rows: _Rows, control: Array) -> tuple[Array, Array, Array, tuple[Array, Array, Array, Array]]:
        """Jerk, acceleration, sideways distance and speed over their aims (4, M), corners' distances, the slow-down each asks

        for.
        """
        lay = rows.lay
        q, v, a = lay.knot_values(control)
        j = np.zeros_like(a)
        j[:-1] = np.diff(a, axis=0) / lay.spacing_s[:-1, None]
        offset = q - rows.target
        sideways = np.abs(offset[:, 1] * rows.tangent[:, 0] - offset[:, 0] * rows.tangent[:, 1])
        fastest_motor = np.abs(v @ self.kinematics.steps_per_mm.T).max(axis=1) / (AIM_SPEED * self.kinematics.max_step_rate)
        ratio = np.stack((
            np.where(lay.is_interval, np.hypot(j[:, 0], j[:, 1]) / self.jerk, 0.0),
            np.where(lay.is_knot, np.hypot(a[:, 0], a[:, 1]) / self.accel, 0.0),
            np.where(lay.is_knot, sideways / rows.room, 0.0),
            np.where(lay.is_knot, np.maximum(np.hypot(v[:, 0], v[:, 1]) / self.speed, fastest_motor), 0.0),
        ))  # fmt: skip
        anchors = rows.anchors
        at = sum(anchors.basis[k][:, None] * control[np.minimum(anchors.row + k, len(control) - 1)] for k in range(4))
        miss = at - anchors.target
        xx, xy, yy = anchors.metric.T
        anchor_ratio = np.sqrt(np.maximum(0.0, xx * miss[:, 0] ** 2 + 2 * xy * miss[:, 0] * miss[:, 1] + yy * miss[:, 1] ** 2))
        local = np.maximum(np.maximum(np.cbrt(ratio[0]), np.sqrt(ratio[1])), np.maximum(ratio[2] ** 0.6, ratio[3]))
        if len(anchor_ratio):
            np.maximum.at(local, anchors.row, anchor_ratio**0.6)
        return ratio, anchor_ratio, local, (q, v, a, j)

    def _within(self, rows: _Rows, ratio: Array, states: tuple[Array, Array, Array, Array]) -> Mask:
        """The blocks whose every piece keeps the true limits on jerk, acceleration and speed, and seems to keep the

        tolerance.
        """
        # Inside a piece speed exceeds the chord of its ends by at most |j| h^2 / 8 in each direction: add that to be sure.
        slack = np.where(rows.lay.is_interval, np.hypot(states[3][:, 0], states[3][:, 1]), 0.0) * rows.lay.spacing_s**2 / 8.0
        speed = ratio[3] + slack * (1.0 / self.speed)
        over = np.maximum(
            np.maximum(ratio[0] * (AIM_JERK / TAKE), ratio[1] * (AIM_ACCELERATION / TAKE)),
            np.maximum(ratio[2] * AIM_TOLERANCE, speed * (AIM_SPEED / TAKE)),
        )
        return np.asarray(np.maximum.reduceat(over, rows.lay.first) <= 1.0)

    def _take(self, rows: _Rows, ready: Mask, states: tuple[Array, Array, Array, Array], over: Array) -> Mask:
        """Verify the ready blocks' distance to their paths, both ways, and keep those that pass. Marks where the others fail

        in `over`.
        """
        lay = rows.lay
        chosen = ready[lay.block]
        q, v, a, j = (x[chosen & lay.is_interval] for x in states)
        h = lay.spacing_s[chosen & lay.is_interval]
        path = rows.path[chosen & lay.is_interval]
        s = rows.s[chosen & lay.is_interval]
        miss, along = deviation(self.paths, q, v, a, j, h, path, s, self.start_s)
        source = np.flatnonzero(chosen & lay.is_interval)
        allowed = self.limits.tolerance_mm * 0.9999 - self.slack[path]
        np.maximum.at(over, source, np.where(miss > allowed, np.maximum(1.002, (miss / self.tolerance) ** 0.6), 0.0))
        failed = np.zeros(len(rows.blocks), dtype=np.bool_)
        failed[lay.block[source[miss > allowed]]] = True
        done = ready & ~failed
        along_rows = rows.s.copy()
        along_rows[source] = along
        for b in np.flatnonzero(done):
            rows_of = slice(lay.first[b], lay.first[b] + lay.intervals[b] + 1)
            at = int(rows.blocks[b])
            position, velocity, acceleration = states[0][rows_of].copy(), states[1][rows_of].copy(), states[2][rows_of].copy()
            position[0], velocity[0], acceleration[0] = self.states[at]
            position[-1], velocity[-1], acceleration[-1] = self.end_states[at]
            ticks = np.full(lay.intervals[b], rows.spacing_ticks[b], dtype=np.int64)
            reached = along_rows[rows_of] - self.paths.s_mm[self.paths.first[at]]
            self.results[at] = Fit(ticks, position, velocity, acceleration, reached)
        return np.asarray(done)

    def _reweigh(self, rows: _Rows, ratio: Array, anchor_ratio: Array) -> None:
        aim = np.array([[LEVEL], [LEVEL], [LEVEL_TOLERANCE]])
        scaled = ratio[:3] / aim
        rows.weights += np.where(scaled > 1.0, 3.0, 0.5) * np.log(np.clip(scaled, 0.3, 3.0))
        np.clip(rows.weights, -40.0, 25.0, out=rows.weights)
        scaled = anchor_ratio / LEVEL_TOLERANCE
        rows.anchor_weight = np.clip(
            rows.anchor_weight + np.where(scaled > 1.0, 3.0, 0.5) * np.log(np.clip(scaled, 0.3, 3.0)), -40.0, 25.0
        )

    def _slow_down(self, stage: int, at_s: Array, over: Array, blocks: Ints) -> None:
        width = 2 * int(np.ceil(0.5 * self.window_s / self.spacing_s)) + 1
        spread = uniform_filter1d(maximum_filter1d(np.maximum(over, 1.0), width), 3)
        gain = 0.4 if stage < 4 else 0.64 if stage < 8 else 1.0
        step = gain * np.log(np.maximum(spread, 1.0))
        if stage >= 4:
            step = np.where(spread > 1.002, np.maximum(step, 0.02 * (stage - 3)), step)
        here = np.isin(self.grid.path, blocks)
        self.slow[here] += np.interp(self.grid.s_mm[here], at_s, step)


# --- helpers -----------------------------------------------------------------------------------------------------------


def _rest_at(point_mm: Array) -> Array:
    return np.stack((point_mm, np.zeros(2), np.zeros(2)))


def _sub_grid(grid: Grid, blocks: Ints) -> Grid:
    """The grid of some of the paths; `path` keeps its meaning, first and last follow `blocks`."""
    mask = np.isin(grid.path, blocks)
    counts = (grid.last - grid.first + 1)[blocks]
    last = np.cumsum(counts) - 1
    return Grid(grid.s_mm[mask], grid.path[mask], grid.cap_mm_s[mask], grid.curvature[mask], last - counts + 1, last)


def _clock(grid: Grid, speed: Array) -> Array:
    """Time at each grid place, with a second between paths, so that it rises over the whole set."""
    ds = np.diff(grid.s_mm)
    mean = 0.5 * (speed[1:] + speed[:-1])
    dt = ds / np.maximum(mean, 1e-9)
    dt[grid.last[:-1]] = 1.0
    return np.concatenate(([0.0], np.cumsum(dt)))


def _place(grid: Grid, speed: Array, time: Array, at: Array, block: Ints) -> Array:
    """Where along the path the profile is at times `at` (speed is linear in time between grid places)."""
    i = np.clip(np.searchsorted(time, at, side="right") - 1, grid.first[block], grid.last[block] - 1)
    dt = time[i + 1] - time[i]
    tau = np.clip(at - time[i], 0.0, dt)
    share = tau * (speed[i] + 0.5 * (speed[i + 1] - speed[i]) * tau / np.maximum(dt, 1e-300))
    return np.asarray(np.minimum(grid.s_mm[i] + share, grid.s_mm[i + 1]))


def _knots(wanted_s: Array, spacing_s: float) -> tuple[Ints, Ints]:
    """Number of intervals and whole ticks of each, for each block: about `spacing_s`, the least total not below what is

    wanted.
    """
    wanted = np.ceil(wanted_s / TICK_S - 1e-9)[:, None]
    base = spacing_s / TICK_S
    choice = np.arange(int(0.8 * base), int(np.ceil(1.1 * base)) + 1)[None, :]
    intervals = np.maximum(np.ceil(wanted / choice), FEWEST_INTERVALS)
    # Of the totals that are nearly least, the one with fewest pieces.
    best = np.argmin(intervals * choice + 0.002 * wanted * np.abs(choice / base - 1.05), axis=1)
    k = intervals[np.arange(len(best)), best].astype(np.int64)
    ticks = np.maximum(np.ceil(wanted[:, 0] / k), int(0.5 * base)).astype(np.int64)
    return k, ticks


def _kept(rows: _Rows, keep: Mask) -> _Rows:
    """The same system without the blocks that are done. Blocks are independent, so that rows can simply go."""
    lay = rows.lay
    mask = keep[lay.block]
    count = lay.intervals[keep]
    first = np.cumsum(count + 3) - (count + 3)
    new_block = np.cumsum(keep) - 1
    moved = np.cumsum(mask) - 1
    small = spline.Layout(first, count, new_block[lay.block[mask]], lay.time_s[mask], lay.spacing_s[mask], lay.is_knot[mask],
                          lay.is_interval[mask], lay.value[:, mask], lay.velocity[:, mask], lay.acceleration[:, mask],
                          lay.jerk[:, mask], (lay.reach[0][mask], lay.reach[1][mask], lay.reach[2][mask],
                          lay.reach[3][mask]))  # fmt: skip
    with_anchor = keep[rows.anchor_block] if len(rows.anchor_block) else np.zeros(0, dtype=np.bool_)
    fixed = mask[rows.fixed.row]
    a = rows.anchors
    return replace(
        rows, blocks=rows.blocks[keep], lay=small, spacing_ticks=rows.spacing_ticks[keep], s=rows.s[mask], path=rows.path[mask],
        target=rows.target[mask], tangent=rows.tangent[mask], room=rows.room[mask], weights=rows.weights[:, mask],
        anchors=banded.Anchors(moved[a.row[with_anchor]], a.basis[:, with_anchor], a.target[with_anchor],
        a.metric[with_anchor]), anchor_weight=rows.anchor_weight[with_anchor],
        anchor_block=new_block[rows.anchor_block[with_anchor]], anchor_room=rows.anchor_room[with_anchor],
        fixed=banded.Fixed(moved[rows.fixed.row[fixed]], rows.fixed.value[fixed]),
    )  # fmt: skip


def deviation(
    paths: PathSet, q: Array, v: Array, a: Array, j: Array, h: Array, path: Ints, s_guess: Array, start_s: Array
) -> tuple[Array, Array]:
    """How far each piece (n,) is from its path, the path's vertices from the motion included, and where along the path it
    starts.

    Never too small: what could happen between samples (|a| dt^2 / 8) is added. Pieces of one path follow each other.
    """
    n = len(h)
    x = (np.arange(SAMPLES) / SAMPLES)[None, :, None]
    t = x * h[:, None, None]
    at = (q[:, None] + t * (v[:, None] + t * (a[:, None] / 2.0 + t * j[:, None] / 6.0))).reshape(-1, 2)
    next_guess = np.concatenate((s_guess[1:], s_guess[-1:]))
    same = np.concatenate((path[1:] == path[:-1], [False]))
    next_guess = np.where(same, next_guess, s_guess)
    guess = (s_guess[:, None] + x[..., 0] * (next_guess - s_guess)[:, None]).ravel()
    sample_path = np.repeat(path, SAMPLES)
    off, along = distance_to_path(paths, at, sample_path, guess)
    sagitta = np.hypot(a[:, 0], a[:, 1]) + np.hypot(j[:, 0], j[:, 1]) * h
    sagitta *= (h / SAMPLES) ** 2 / 8.0
    miss = off.reshape(n, SAMPLES).max(axis=1) + sagitta

    # Each vertex to the chords of the samples around it; ends are met exactly.
    last_of = np.concatenate((path[1:] != path[:-1], [True]))
    used = np.zeros(len(paths.first), dtype=np.bool_)
    used[path] = True
    is_end = np.zeros(len(paths.s_mm), dtype=np.bool_)
    is_end[paths.first] = is_end[paths.last] = True
    vertex = np.flatnonzero(used[paths.path] & ~is_end & (paths.s_mm > start_s[paths.path] + 1e-9))
    if not len(vertex):
        return miss, along[::SAMPLES]
    ends = at[1:].copy()
    chord_ok = ~np.repeat(last_of, SAMPLES)[:-1] | (sample_path[1:] == sample_path[:-1])
    m = np.clip(np.searchsorted(guess, paths.s_mm[vertex]) - 1, 0, len(at) - 2)
    nearest = np.full(len(vertex), np.inf)
    owner = m.copy()
    todo = np.arange(len(vertex))
    for _ in range(4):
        centre = owner[todo]
        moved = np.zeros(len(todo), dtype=np.bool_)
        here = centre.copy()
        for step in range(-3, 4):
            i = np.clip(centre + step, 0, len(at) - 2)
            chord = ends[i] - at[i]
            offset = paths.point_mm[vertex[todo]] - at[i]
            share = np.clip((offset * chord).sum(axis=1) / np.maximum((chord * chord).sum(axis=1), 1e-300), 0.0, 1.0)
            rest = offset - share[:, None] * chord
            distance = np.hypot(rest[:, 0], rest[:, 1])
            distance = np.where(chord_ok[i] & (sample_path[i] == paths.path[vertex[todo]]), distance, np.inf)
            nearer = distance < nearest[todo]
            nearest[todo[nearer]] = distance[nearer]
            here[nearer] = i[nearer]
            moved |= nearer & (i != centre)
        owner[todo] = here
        todo = todo[moved]
        if not len(todo):
            break
    np.maximum.at(miss, owner // SAMPLES, nearest + sagitta[owner // SAMPLES])
    return miss, along[::SAMPLES]
