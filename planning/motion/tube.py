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
from dataclasses import dataclass, field

import numpy as np
from numpy.linalg import LinAlgError
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from planning.motion import banded, spline
from planning.motion.deviation import deviation
from planning.motion.fit import Fit, joined
from planning.motion.knots import fewer_pieces
from planning.motion.limits import Kinematics, Limits
from planning.motion.path import Array, Ints, Mask, PathSet, path_set
from planning.motion.plan import TICK_S
from planning.motion.speed import CORNER_SLOWNESS, Grid, fastest, make_grid, speed_caps

# The fit aims below the limits by these parts, and is taken when it is within the limits themselves (less rounding).
AIM_SPEED, AIM_ACCELERATION, AIM_JERK, AIM_TOLERANCE = 0.985, 0.985, 0.97, 0.94
TAKE = 0.9998
# Levelling aims a little lower still, so that the last few places come down too.
LEVEL, LEVEL_TOLERANCE = 0.975, 0.92
STAGES = 24
FIRST_ROUNDS, ROUNDS = 12, 12
FEWEST_INTERVALS = 6
# Patches: margin beside a bad place in units of the corner window, and rounds of slowing down before it is widened.
PATCH_MARGIN = 2.5
PATCH_STAGES = 6
DROPPED = 10_000
# Patches are cheap: every time one has failed, levelling gets this many more rounds.
STUBBORN_ROUNDS = 8
# After this many rounds the weights should have settled; what follows is done in smaller steps.
SETTLED = 16
# Pieces 4, 3, 2 knot spacings long where the profile's jerk stays below these parts of its limit; no longer than LONGEST_S;
# in the first stages of a whole section only.
CALM_JERK = (0.1, 0.25, 0.45)
LONGEST_S = 0.040
COARSE_STAGES = 4
TANGENTIAL_WEIGHT = 0.05


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
class Tuning:
    """What a retry may change: knot spacing, and how much of the speed limit to use at first."""

    spacing_s: float
    speed_share: float = 1.0


def knot_spacing_s(limits: Limits) -> float:
    """The knot interval: short beside the time A / J that acceleration takes to build, and beside the time sqrt(2 tol / A) in
    which full acceleration crosses the tolerance; and long enough for the board."""
    across = np.sqrt(2.0 * limits.tolerance_mm / limits.acceleration_mm_s2)
    return float(np.clip(min(0.4 * limits.acceleration_mm_s2 / limits.jerk_mm_s3, 1.3 * across), 0.005, 0.010))


def fit_sections(
    sections: Sequence[Section], limits: Limits, kinematics: Kinematics, tuning: Tuning | None = None
) -> list[Fit | None]:
    """A motion for each section, within `limits` at every instant; None where none was found in STAGES rounds of slowing

    down.
    """
    if not sections:
        return []
    chosen = tuning or Tuning(knot_spacing_s(limits))
    try:
        return _Solver(sections, limits, kinematics, chosen).run()
    except LinAlgError:
        # The weights of one stroke ran away: the others are solved without it.
        if len(sections) == 1:
            return [None]
        return [fit for section in sections for fit in fit_sections([section], limits, kinematics, chosen)]


@dataclass(eq=False, slots=True)
class _Block:
    """One piece of work: a stretch of a path between two states. A root covers its section; patches mend the bad places of a
    root's fit.

    `low`, `high` are the knots of the root's draft that a patch replaces.
    """

    path: int
    from_s: float
    to_s: float
    start: Array
    end: Array
    moving_start: bool
    moving_end: bool
    root: _Block | None = None
    low: int = 0
    high: int = 0
    stage: int = 0
    widened: int = 0
    fit: Fit | None = None
    draft: Fit | None = None
    patches: list[_Block] = field(default_factory=list)
    whole: bool = False
    slow_from: int = 0
    slow_before: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(eq=False, slots=True)
class _Rows:
    """One stage's system: per-row arrays over the blocks still unsolved."""

    blocks: list[_Block]
    lay: spline.Layout
    s: Array
    path: Ints
    target: Array
    tangent: Array
    room: Array
    weights: Array
    anchors: banded.Anchors
    anchor_weight: Array
    anchor_block: Ints
    fixed: banded.Fixed


@dataclass(frozen=True, eq=False, slots=True)
class _Best:
    """The best iterate of the blocks that were not taken: how far over its bounds each row is, and its states (M, 2)."""

    rows: _Rows
    over: Array
    position: Array
    velocity: Array
    acceleration: Array


class _Solver:
    def __init__(self, sections: Sequence[Section], limits: Limits, kinematics: Kinematics, tuning: Tuning) -> None:
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
        self.margin = int(np.ceil(PATCH_MARGIN * self.window_s / tuning.spacing_s)) + 2
        self.paths: PathSet = path_set([x.points_mm for x in sections], [x.corners for x in sections], limits.tolerance_mm)
        paths = self.paths
        aim = Limits(self.speed * tuning.speed_share, self.accel, self.jerk, self.tolerance)
        vertex_cap, segment_cap = speed_caps(paths, aim, kinematics, self.window_s)
        self.grid = make_grid(paths, vertex_cap, segment_cap, aim, self.window_s)
        self.slow = self._first_slowness()
        self.roots = []
        for i, section in enumerate(sections):
            start = section.state if section.state is not None else _rest_at(section.points_mm[0])
            from_s = float(paths.s_mm[paths.first[i]]) + section.from_mm
            end_s = float(paths.s_mm[paths.last[i]])
            moving = section.state is not None
            self.roots.append(_Block(i, from_s, end_s, start, _rest_at(section.points_mm[-1]), moving, False))

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

    # --- stages ----------------------------------------------------------------------------------------------------

    def run(self) -> list[Fit | None]:
        """Level, take what keeps its bounds, slow down where the rest does not, and go on with that alone."""
        work = list(self.roots)
        remembered: tuple[Array, Array] | None = None
        for stage in range(2 * STAGES):
            if not work:
                break
            work.sort(key=lambda b: b.from_s)
            rows = self._rows(work, remembered)
            stubborn = min(b.stage for b in work) if all(b.root is not None for b in work) else 0
            rounds = FIRST_ROUNDS if stage == 0 else ROUNDS + STUBBORN_ROUNDS * stubborn
            best, remembered = self._level(rows, rounds)
            if best is None:
                break
            self._slow_down(best)
            work = [w for i, block in enumerate(best.rows.blocks) for w in self._next(best, i, block)]
            work = [w for w in work if w.stage < DROPPED]
        return self._results()

    def _results(self) -> list[Fit | None]:
        """The roots' fits with fewer pieces; those that were changed after they had been taken are verified once more as a

        whole.
        """
        found = [_assembled(root) for root in self.roots]
        for i, root in enumerate(self.roots):
            fit = found[i]
            if fit is not None and root.fit is None and not self._keeps(fit, root):
                found[i] = None
        have = [i for i, fit in enumerate(found) if fit is not None]
        allowed = np.array([self._allowed(i) for i in range(len(self.slack))])
        fits = [fit for fit in found if fit is not None]
        for i, fewer in zip(have, fewer_pieces(self.paths, have, fits, self.limits, self.kinematics, allowed), strict=True):
            before = found[i]
            assert before is not None
            fit = fewer if len(fewer.ticks) < len(before.ticks) and self._keeps(fewer, self.roots[i]) else before
            found[i] = fit.moved(-float(self.paths.s_mm[self.paths.first[i]]))
        return found

    def _keeps(self, fit: Fit, root: _Block) -> bool:
        states = np.stack((fit.position_mm, fit.velocity_mm_s, fit.acceleration_mm_s2), axis=1)
        miss, _ = self._deviation_of(states, fit.ticks, fit.along_mm, root)
        return bool(miss.max() <= self._allowed(root.path))

    def _next(self, best: _Best, i: int, block: _Block) -> list[_Block]:
        """What to do next about a block that was not taken: itself again, patches of it, a wider patch, or nothing any more."""
        if block.stage >= DROPPED:
            return []
        block.stage += 1
        if block.root is None:
            if block.stage >= STAGES:
                return []
            return self._patched(best, i, block) if block.stage >= 2 and not block.whole else [block]
        if block.stage < PATCH_STAGES:
            return [block]
        if block.widened >= 2:
            return self._whole_again(block.root)
        return self._widened(block)

    def _patched(self, best: _Best, i: int, block: _Block) -> list[_Block]:
        """Keep the good part of this draft and cut its bad places out, each with a margin; all of it again when most of it is

        bad.
        """
        lay = best.rows.lay
        count = int(lay.intervals[i])
        rows = slice(int(lay.first[i]), int(lay.first[i]) + count + 1)
        ticks = np.rint(lay.spacing_s[rows][:-1] / TICK_S).astype(np.int64)
        states = np.stack((best.position[rows], best.velocity[rows], best.acceleration[rows]), axis=1)
        states[0], states[-1] = block.start, block.end
        miss, along = self._deviation_of(states, ticks, best.rows.s[rows], block)
        off = np.hypot(*(best.position[rows] - best.rows.target[rows])[:-1].T)
        along = _trusted(along, best.rows.s[rows][:-1], off, block.from_s, block.to_s)
        bad = best.over[rows] > 1.0
        bad[:-1] |= miss > self._allowed(block.path)
        wide = maximum_filter1d(bad.astype(np.int8), 2 * self.margin + 1, mode="constant") > 0
        if wide.mean() > 0.6:
            return [block]
        block.draft = Fit(ticks, states[:, 0], states[:, 1], states[:, 2], np.append(along, block.to_s))
        edges = np.flatnonzero(np.diff(np.concatenate(([0], wide.astype(np.int8), [0]))))
        block.slow_from, to = (int(k) for k in np.searchsorted(self.grid.s_mm, (block.from_s, block.to_s)))
        block.slow_before = self.slow[block.slow_from : to].copy()
        block.patches = []
        for low, high in zip(edges[::2], edges[1::2] - 1, strict=True):
            block.patches.append(self._patch(block, int(low), int(high), 0))
        return list(block.patches)

    def _patch(self, root: _Block, low: int, high: int, widened: int) -> _Block:
        draft = root.draft
        assert draft is not None
        count = len(draft.ticks)
        low, high = max(0, low), min(count, high)
        if high - low < FEWEST_INTERVALS:
            low, high = max(0, low - FEWEST_INTERVALS), min(count, high + FEWEST_INTERVALS)
        states = np.stack((draft.position_mm, draft.velocity_mm_s, draft.acceleration_mm_s2), axis=1)
        from_s = root.from_s if low == 0 else float(draft.along_mm[low])
        to_s = root.to_s if high == count else float(draft.along_mm[high])
        moving_start, moving_end = root.moving_start or low > 0, root.moving_end or high < count
        return _Block(root.path, from_s, to_s, states[low], states[high], moving_start, moving_end, root, low, high,
                      widened=widened)  # fmt: skip

    def _widened(self, block: _Block) -> list[_Block]:
        """A patch that could not be mended takes in more on both sides, and its neighbours with it where they meet."""
        root = block.root
        assert root is not None
        low, high, widened = block.low - 3 * self.margin, block.high + 3 * self.margin, block.widened + 1
        met = [p for p in root.patches if p is not block and p.low <= high and p.high >= low]
        for patch in met:
            low, high = min(low, patch.low), max(high, patch.high)
        root.patches = [p for p in root.patches if p is not block and p not in met]
        # What slowing down did not help is taken back.
        here = slice(*np.searchsorted(self.grid.s_mm, (block.from_s, block.to_s)))
        self.slow[here] = root.slow_before[here.start - root.slow_from : here.stop - root.slow_from]
        for patch in met:
            patch.stage = DROPPED
        root.patches.append(self._patch(root, low, high, widened))
        return [root.patches[-1]]

    def _whole_again(self, root: _Block) -> list[_Block]:
        """A root whose patches do not come together is done as one, as if there had been none."""
        for patch in root.patches:
            patch.stage = DROPPED
        self.slow[root.slow_from : root.slow_from + len(root.slow_before)] = root.slow_before
        root.patches, root.draft, root.whole = [], None, True
        return [root]

    def _allowed(self, path: int) -> float:
        return float(self.limits.tolerance_mm * 0.9999 - self.slack[path])

    def _deviation_of(self, states: Array, ticks: Ints, s: Array, block: _Block) -> tuple[Array, Array]:
        h = (ticks * TICK_S).astype(np.float64)
        jerk = np.diff(states[:, 2], axis=0) / h[:, None]
        span = (np.array([block.path]), np.array([block.from_s]), np.array([block.to_s]), states[-1:, 0])
        pieces = (states[:-1, 0], states[:-1, 1], states[:-1, 2], jerk)
        return deviation(self.paths, pieces, h, np.zeros(len(h), dtype=np.int64), span, s[:-1], 0.9 * self.tolerance)

    # --- one stage's system ----------------------------------------------------------------------------------------

    def _places(self, blocks: list[_Block]) -> tuple[Grid, Array]:
        """The blocks' parts of the grid with their own ends added (path is the block's index), and the slowness there."""
        grid = self.grid
        from_s, to_s = np.array([b.from_s for b in blocks]), np.array([b.to_s for b in blocks])
        low = np.searchsorted(grid.s_mm, from_s + 1e-7, side="right")
        high = np.maximum(np.searchsorted(grid.s_mm, to_s - 1e-7, side="left"), low)
        count = high - low + 2
        last = np.cumsum(count) - 1
        first = last - count + 1
        block = np.repeat(np.arange(len(blocks)), count)
        source = np.clip(np.arange(int(count.sum())) - first[block] - 1 + low[block], 0, len(grid.s_mm) - 1)
        s, cap, curvature, slow = grid.s_mm[source], grid.cap_mm_s[source], grid.curvature[source], self.slow[source]
        for at, ends, states in ((first, from_s, [b.start for b in blocks]), (last, to_s, [b.end for b in blocks])):
            s[at] = ends
            curvature[at] = np.interp(ends, grid.s_mm, grid.curvature)
            slow[at] = 0.0
            cap[at] = np.hypot(*np.stack([x[1] for x in states]).T)
        return Grid(s, block, cap, curvature, first, last), slow

    def _rows(self, blocks: list[_Block], remembered: tuple[Array, Array] | None) -> _Rows:
        grid, slow = self._places(blocks)
        factor = np.exp(-slow)
        # What moves at its end cannot be slower next to it than braking allows.
        reach = np.zeros(len(slow))
        for at in (grid.first, grid.last):
            away = np.abs(grid.s_mm - grid.s_mm[at][grid.path])
            reach = np.maximum(reach, grid.cap_mm_s[at][grid.path] ** 2 - 2.0 * self.accel * away)
        cap = np.maximum(grid.cap_mm_s * factor, np.sqrt(np.maximum(reach, 0.0)))
        speed = fastest(grid, cap, self.accel * factor * factor)
        time = _clock(grid, speed)
        begin, total = time[grid.first], time[grid.last] - time[grid.first]
        rest_start = np.array([not b.moving_start for b in blocks])
        rest_end = np.array([not b.moving_end for b in blocks])
        wanted = 1.003 * total + 0.5 * self.ramp_s * (rest_start * 1.0 + rest_end)
        intervals, ticks = _knots(wanted, self.spacing_s)
        lay = spline.layout(np.repeat(ticks * TICK_S, intervals).astype(np.float64), intervals, self.spacing_s)
        # At a rest the spline lags behind the profile by half the ramp; at a moving end it does not.
        duration = lay.time_s[lay.first + intervals]
        spare = np.where(rest_start & rest_end, duration - total, 0.5 * self.ramp_s * (rest_start * 1.0 + rest_end))
        head = np.where(rest_start, np.where(rest_end, 0.5, 1.0) * spare, 0.0)
        stretch = (duration - spare) / np.maximum(total, 1e-9)
        t = np.clip((lay.time_s - head[lay.block]) / stretch[lay.block], 0.0, total[lay.block]) + begin[lay.block]
        s = _place(grid, speed, time, t, lay.block)
        lay, s = self._coarsened(blocks, lay, s)
        path = np.array([b.path for b in blocks])[lay.block]
        target, tangent = self.paths.curve(s, path)
        bulge = self.paths.bulge_mm[self.paths.segment(s, path)]
        room = np.maximum(self.tolerance - bulge - self.slack[path], 0.3 * self.tolerance)
        anchors, anchor_block = self._anchors(blocks, grid, time - begin[grid.path], head, stretch, lay)
        if remembered is None:
            weights = np.tile(np.array([[0.0], [-2.0], [-2.0]]), (1, len(s)))
        else:
            # Weights must be mostly forgotten from stage to stage, or the levelling never settles.
            weights = 0.25 * np.stack([np.interp(s, remembered[0], w) for w in remembered[1]])
        return _Rows(blocks, lay, s, path, target, tangent, room, weights, anchors, np.full(len(anchors.row), 2.0),
                     anchor_block, self._fixed(lay, blocks))  # fmt: skip

    def _coarsened(self, blocks: list[_Block], lay: spline.Layout, s: Array) -> tuple[spline.Layout, Array]:
        """Fewer knots where the profile wants little jerk for a while. Patches and stubborn blocks keep all of theirs."""
        path = np.array([b.path for b in blocks])[lay.block]
        point, _ = self.paths.curve(s, path)
        third = np.zeros(len(s))
        third[1:-2] = np.hypot(*(point[3:] - 3.0 * point[2:-1] + 3.0 * point[1:-2] - point[:-3]).T)
        third /= self.jerk * lay.spacing_s**3
        fine = np.array([b.root is not None or b.stage >= COARSE_STAGES for b in blocks])
        inner = lay.is_interval & (np.arange(len(s)) > lay.first[lay.block]) & ~fine[lay.block]
        third[~(inner & np.append(inner[2:], (False, False)))] = np.inf
        width = 2 * int(np.ceil(self.window_s / self.spacing_s)) + 3
        wanted = maximum_filter1d(third, width)
        merge = np.where(
            wanted < CALM_JERK[0], 4.0, np.where(wanted < CALM_JERK[1], 3.0, np.where(wanted < CALM_JERK[2], 2.0, 1.0))
        )
        merge = np.minimum(merge, max(1.0, np.floor(LONGEST_S / self.spacing_s)))
        if merge.max() == 1.0:
            return lay, s
        passed = np.cumsum(1.0 / merge)
        keep = np.concatenate(([True], np.floor(passed[1:] + 1e-9) > np.floor(passed[:-1] + 1e-9)))
        keep = np.concatenate(([True], keep[:-1])) & lay.is_knot
        keep[lay.first] = keep[lay.first + lay.intervals] = True
        # The states given at the ends take three control points each: leave the pieces next to them short.
        for k in range(1, 4):
            keep[lay.first + k] = keep[lay.first + lay.intervals - k] = True
        count = np.add.reduceat(keep.astype(np.int64), lay.first) - 1
        chosen = np.flatnonzero(keep)
        same = lay.block[chosen][1:] == lay.block[chosen][:-1]
        spacing = np.diff(lay.time_s[chosen])[same]
        fewer = spline.layout(spacing, count, self.spacing_s)
        new_s = np.empty(len(fewer.block))
        new_s[fewer.is_knot] = s[chosen]
        new_s[~fewer.is_knot] = np.repeat(s[lay.first + lay.intervals], 2)
        return fewer, new_s

    def _fixed(self, lay: spline.Layout, blocks: list[_Block]) -> banded.Fixed:
        start, end = np.stack([b.start for b in blocks]), np.stack([b.end for b in blocks])
        last = lay.first + lay.intervals
        head = spline.control_of_state(lay, lay.first, start[:, 0], start[:, 1], start[:, 2])
        tail = spline.control_of_state(lay, last, end[:, 0], end[:, 1], end[:, 2])
        rows = np.concatenate([lay.first + k for k in range(3)] + [last + k for k in range(3)])
        return banded.Fixed(rows, np.concatenate(head + tail))

    def _anchors(
        self, blocks: list[_Block], grid: Grid, time: Array, head: Array, stretch: Array, lay: spline.Layout
    ) -> tuple[banded.Anchors, Ints]:
        """The corners that the pen must come near at their own time: sideways, or from all sides where it nearly turns back."""
        paths = self.paths
        corner = np.flatnonzero(paths.sharp)
        block = np.searchsorted([b.from_s for b in blocks], paths.s_mm[corner], side="right") - 1
        inside = (block >= 0) & (paths.s_mm[corner] > grid.s_mm[grid.first][block] + 1e-6)
        inside &= paths.s_mm[corner] < grid.s_mm[grid.last][block] - 1e-6
        corner, block = corner[inside], block[inside]
        place = np.searchsorted(grid.s_mm, paths.s_mm[corner])
        t = time[place] * stretch[block] + head[block]
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
        return banded.Anchors(row, spline.basis_at(lay, row, after), paths.point_mm[corner], metric), block

    def _level(self, rows: _Rows, rounds: int) -> tuple[_Best | None, tuple[Array, Array]]:
        """Reweight until every block is taken or the rounds are over. Returns the best iterate of those not taken, and all

        weights.
        """
        score = np.full(len(rows.blocks), np.inf)
        best = _Best(rows, np.ones(len(rows.s)), *(np.zeros((len(rows.s), 2)) for _ in range(3)))
        for turn in range(rounds):
            control = self._solve(rows)
            ratio, anchor_ratio, local, over, states = self._ratios(rows, control)
            bad = np.add.reduceat(np.maximum(over - 1.0, 0.0), rows.lay.first)
            ready = np.maximum.reduceat(over, rows.lay.first) <= 1.0
            better = (bad < score) | ready
            score = np.minimum(score, bad)
            wish = np.where(over > 1.0, np.maximum(local, over**0.3), np.minimum(local, 1.0))
            best = _improved(best, better[rows.lay.block], wish, states)
            done = np.zeros(len(rows.blocks), dtype=np.bool_)
            if ready.any():
                done = self._take(rows, ready, states, best.over)
            if done.all():
                return None, (rows.s, rows.weights)
            self._reweigh(rows, ratio, anchor_ratio, turn)
            if done.any():
                keep = ~done
                mask = keep[rows.lay.block]
                score = score[keep]
                rows = _kept(rows, keep)
                best = _Best(rows, best.over[mask], best.position[mask], best.velocity[mask], best.acceleration[mask])
        valid = rows.lay.is_knot
        return best, (rows.s[valid], rows.weights[:, valid])

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

    def _ratios(self, rows: _Rows, control: Array) -> tuple[Array, Array, Array, Array, tuple[Array, Array, Array, Array]]:
        """What one iterate makes of the bounds.

        Jerk, acceleration and sideways distance over their aims (3, M); corners' distances; the slow-down each row asks for
        (M,); how far each row is over its true bounds (M,), 1 being just within; and the states there.
        """
        lay = rows.lay
        q, v, a = lay.knot_values(control)
        j = np.zeros_like(a)
        j[:-1] = np.diff(a, axis=0) / lay.spacing_s[:-1, None]
        offset = q - rows.target
        sideways = np.abs(offset[:, 1] * rows.tangent[:, 0] - offset[:, 0] * rows.tangent[:, 1])
        motor = np.where(lay.is_interval, self.kinematics.step_rate_share(v, a, j, lay.spacing_s) / AIM_SPEED, 0.0)
        ratio = np.stack((
            np.where(lay.is_interval, np.hypot(j[:, 0], j[:, 1]) / self.jerk, 0.0),
            np.where(lay.is_knot, np.hypot(a[:, 0], a[:, 1]) / self.accel, 0.0),
            np.where(lay.is_knot, sideways / rows.room, 0.0),
        ))  # fmt: skip
        speed = np.where(lay.is_knot, np.hypot(v[:, 0], v[:, 1]) / self.speed, 0.0)
        anchors = rows.anchors
        at = sum(anchors.basis[k][:, None] * control[anchors.row + k] for k in range(4))
        miss = at - anchors.target
        xx, xy, yy = anchors.metric.T
        anchor_ratio = np.sqrt(np.maximum(0.0, xx * miss[:, 0] ** 2 + 2 * xy * miss[:, 0] * miss[:, 1] + yy * miss[:, 1] ** 2))
        local = np.maximum(np.maximum(np.cbrt(ratio[0]), np.sqrt(ratio[1])), np.maximum(ratio[2] ** 0.6, speed))
        local = np.maximum(local, motor)
        # Inside a piece speed exceeds that at its ends by at most |j| h^2 / 8: add that to be sure.
        fast = np.maximum(speed, np.concatenate((speed[1:], speed[-1:])))
        fast = np.maximum(fast + ratio[0] * (self.jerk / self.speed) * lay.spacing_s**2 / 8.0, motor)
        over = np.maximum(
            np.maximum(ratio[0] * (AIM_JERK / TAKE), ratio[1] * (AIM_ACCELERATION / TAKE)),
            np.maximum(ratio[2] * AIM_TOLERANCE, fast * (AIM_SPEED / TAKE)),
        )
        if len(anchor_ratio):
            np.maximum.at(local, anchors.row, anchor_ratio**0.6)
            np.maximum.at(over, anchors.row, anchor_ratio * AIM_TOLERANCE)
        return ratio, anchor_ratio, local, over, (q, v, a, j)

    def _take(self, rows: _Rows, ready: Mask, states: tuple[Array, Array, Array, Array], over: Array) -> Mask:
        """Verify the ready blocks' distance to their paths, both ways, and keep those that pass. Marks where the others

        fail.
        """
        lay = rows.lay
        source = np.flatnonzero(ready[lay.block] & lay.is_interval)
        chosen = [b for b, r in zip(rows.blocks, ready, strict=True) if r]
        span = (np.array([b.path for b in chosen]), np.array([b.from_s for b in chosen]), np.array([b.to_s for b in chosen]),
                np.stack([b.end[0] for b in chosen]))  # fmt: skip
        pieces = (states[0][source], states[1][source], states[2][source], states[3][source])
        of = (np.cumsum(ready) - 1)[lay.block[source]]
        miss, along = deviation(self.paths, pieces, lay.spacing_s[source], of, span, rows.s[source], 0.9 * self.tolerance)
        allowed = self.limits.tolerance_mm * 0.9999 - self.slack[rows.path[source]]
        np.maximum.at(over, source, np.where(miss > allowed, np.maximum(1.002, (miss / self.tolerance) ** 0.6), 0.0))
        failed = np.zeros(len(rows.blocks), dtype=np.bool_)
        failed[lay.block[source[miss > allowed]]] = True
        rows.weights[2, source[miss > allowed]] += 2.0
        done = ready & ~failed
        off = np.hypot(*(states[0][source] - rows.target[source]).T)
        along_rows = rows.s.copy()
        along_rows[source] = _trusted(along, rows.s[source], off, span[1][of], span[2][of])
        for i in np.flatnonzero(done):
            part = slice(lay.first[i], lay.first[i] + lay.intervals[i] + 1)
            block = rows.blocks[i]
            knots = np.stack((states[0][part], states[1][part], states[2][part]), axis=1)
            knots[0], knots[-1] = block.start, block.end
            ticks = np.rint(lay.spacing_s[part][:-1] / TICK_S).astype(np.int64)
            block.fit = Fit(ticks, knots[:, 0], knots[:, 1], knots[:, 2], along_rows[part])
        return np.asarray(done)

    def _reweigh(self, rows: _Rows, ratio: Array, anchor_ratio: Array, turn: int) -> None:
        """Lawson's step: weigh more what is over its aim, less what is under it; more gently once it should have settled."""
        gain = 1.0 if turn < SETTLED else 0.5
        scaled = ratio / np.array([[LEVEL], [LEVEL], [LEVEL_TOLERANCE]])
        rows.weights += gain * np.where(scaled > 1.0, 3.0, 0.5) * np.log(np.clip(scaled, 0.3, 3.0))
        np.clip(rows.weights, -40.0, 25.0, out=rows.weights)
        scaled = anchor_ratio / LEVEL_TOLERANCE
        step = gain * np.where(scaled > 1.0, 3.0, 0.5) * np.log(np.clip(scaled, 0.3, 3.0))
        rows.anchor_weight = np.clip(rows.anchor_weight + step, -40.0, 25.0)

    def _slow_down(self, best: _Best) -> None:
        """Slow the profile around the places that are over their bounds, more boldly the longer a block has been at it."""
        rows = best.rows
        width = 2 * int(np.ceil(0.5 * self.window_s / self.spacing_s)) + 1
        spread = uniform_filter1d(maximum_filter1d(np.maximum(best.over, 1.0), width), 3)
        stage = np.array([b.stage for b in rows.blocks])[rows.lay.block]
        step = np.where(stage < 4, 0.4, np.where(stage < 8, 0.64, 1.0)) * np.log(np.maximum(spread, 1.0))
        step = np.where((stage >= 4) & (spread > 1.002), np.maximum(step, 0.02 * (stage - 3)), step)
        low = np.searchsorted(self.grid.s_mm, [b.from_s for b in rows.blocks], side="left")
        high = np.searchsorted(self.grid.s_mm, [b.to_s for b in rows.blocks], side="right")
        change = np.zeros(len(self.grid.s_mm) + 1, dtype=np.int64)
        np.add.at(change, low, 1)
        np.add.at(change, high, -1)
        here = np.cumsum(change)[:-1] > 0
        valid = rows.lay.is_knot
        self.slow[here] += np.interp(self.grid.s_mm[here], rows.s[valid], step[valid])


# --- helpers -----------------------------------------------------------------------------------------------------------


def _rest_at(point_mm: Array) -> Array:
    return np.stack((point_mm, np.zeros(2), np.zeros(2)))


def _trusted(along: Array, s: Array, off_mm: Array, low: Array | float, high: Array | float) -> Array:
    """Where knots are along the path. Where it turns back on itself or crosses, the nearest point may be on the wrong leg:
    trust it no further than the pen is off its place."""
    return np.asarray(np.maximum.accumulate(np.clip(np.clip(along, s - 1.2 * off_mm, s + 1.2 * off_mm), low, high)))


def _improved(best: _Best, where: Mask, over: Array, states: tuple[Array, Array, Array, Array]) -> _Best:
    if where.all():
        return _Best(best.rows, over, states[0], states[1], states[2])
    at = where[:, None]
    return _Best(best.rows, np.where(where, over, best.over), np.where(at, states[0], best.position),
                 np.where(at, states[1], best.velocity), np.where(at, states[2], best.acceleration))  # fmt: skip


def _assembled(root: _Block) -> Fit | None:
    """A root's fit: its own, or its draft with every patch put in; None when something is missing."""
    if root.fit is not None or root.draft is None:
        return root.fit
    draft = root.draft
    parts: list[Fit] = []
    at = 0
    for patch in sorted(root.patches, key=lambda p: p.low):
        if patch.fit is None:
            return None
        parts += [draft.between(at, patch.low), patch.fit]
        at = patch.high
    parts.append(draft.between(at, len(draft.ticks)))
    return joined(parts)


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
    anchors = banded.Anchors(moved[a.row[with_anchor]], a.basis[:, with_anchor], a.target[with_anchor], a.metric[with_anchor])
    return _Rows(
        [b for b, k in zip(rows.blocks, keep, strict=True) if k], small, rows.s[mask],
        rows.path[mask], rows.target[mask], rows.tangent[mask], rows.room[mask], rows.weights[:, mask], anchors,
        rows.anchor_weight[with_anchor],
        new_block[rows.anchor_block[with_anchor]], banded.Fixed(moved[rows.fixed.row[fixed]], rows.fixed.value[fixed]),
    )  # fmt: skip
