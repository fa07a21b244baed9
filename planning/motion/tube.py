"""Time-optimal-like motion inside the tolerance tube around a path: the draw planner's heart.

x(t), y(t) is one cubic B-spline in time per stroke, so that jerk is constant on each knot interval and speed and acceleration
are continuous. A speed profile along the path says how long the stroke must last and where each knot should be. The fit levels
jerk, acceleration and distance to the path, each over its own bound, so that every place uses exactly the part of the tube that
it needs (`levelling`). Where the levelled fit still breaks a bound, the profile is slowed down there, and the fit made again.
What is found is made faster where it leaves something of its bounds (`haste`). Many strokes are solved in one banded system;
they do not touch each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import LinAlgError

from planning.motion import interior, spline
from planning.motion.fit import Fit
from planning.motion.haste import hastened
from planning.motion.knots import fewer_pieces
from planning.motion.levelling import FEWEST_INTERVALS, Best, Block, Levelling, Rows, kept, knots, spliced, trusted
from planning.motion.limits import Kinematics, Limits
from planning.motion.path import Array, Ints, Mask, path_set
from planning.motion.plan import TICK_S
from planning.motion.speed import Grid, fastest, make_grid, speed_caps
from planning.motion.windows import even_over_three, highest_around

STAGES = 24
ROUNDS = 8
# Patches: margin beside a bad place in units of the corner window, and rounds of slowing down before it is widened.
PATCH_MARGIN = 2.5
PATCH_STAGES = 6
# A draft that is bad in more of its places than this is done again as a whole.
MOST_BAD = 0.6
DROPPED = 10_000
# A patch is slowed down by this part of what its places ask for, and by this much more every time: it can be hastened later.
PATCH_GAIN, PATCH_STEP = 0.7, 0.015
# Pieces 4, 3, 2 knot spacings long where the profile's jerk stays below these parts of its limit; no longer than LONGEST_S;
# in the first stages of a whole section only.
CALM_JERK = (0.1, 0.25, 0.45)
LONGEST_S = 0.040
COARSE_STAGES = 4
# Blocks whose worst place wants no more slowing down than this are near.
NEAR = 1.1


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


class _Solver:
    def __init__(self, sections: Sequence[Section], limits: Limits, kinematics: Kinematics, tuning: Tuning) -> None:
        self.paths = paths = path_set([x.points_mm for x in sections], [x.corners for x in sections], limits.tolerance_mm)
        self.levelling = Levelling(paths, np.array([x.slack_mm for x in sections]), limits, kinematics, tuning.spacing_s)
        self.accel, self.window_s, self.spacing_s = self.levelling.accel, self.levelling.window_s, tuning.spacing_s
        self.margin = int(np.ceil(PATCH_MARGIN * self.window_s / tuning.spacing_s)) + 2
        aim = Limits(self.levelling.speed * tuning.speed_share, self.accel, self.levelling.jerk, self.levelling.tolerance)
        vertex_cap, segment_cap = speed_caps(paths, aim, kinematics, self.window_s)
        self.grid = make_grid(paths, vertex_cap, segment_cap, aim, self.window_s)
        self.slow = np.zeros(len(self.grid.s_mm))
        self.roots = []
        for i, section in enumerate(sections):
            start = section.state if section.state is not None else _rest_at(section.points_mm[0])
            from_s = float(paths.s_mm[paths.first[i]]) + section.from_mm
            end_s = float(paths.s_mm[paths.last[i]])
            moving = section.state is not None
            self.roots.append(Block(i, from_s, end_s, start, _rest_at(section.points_mm[-1]), moving, False))

    # --- stages ----------------------------------------------------------------------------------------------------

    def run(self) -> list[Fit | None]:
        """Level, take what keeps its bounds, slow down where the rest does not, and go on with that alone."""
        work = list(self.roots)
        remembered: tuple[Array, Array] | None = None
        for _ in range(2 * STAGES):
            if not work:
                break
            work.sort(key=lambda b: b.from_s)
            rows = self._rows(work, remembered)
            best, remembered = self.levelling.level(rows, ROUNDS)
            if best is None:
                break
            self._meet(best)
            self._slow_down(best)
            drafts = self._drafts(best)
            left = [(i, block) for i, block in enumerate(best.rows.blocks) if block.fit is None]
            work = [w for i, block in left for w in self._next(block, drafts.get(i))]
            work = [w for w in work if w.stage < DROPPED]
        return self._results()

    def _meet(self, best: Best) -> None:
        """What levelling has brought near enough, a method that converges may bring within its bounds."""
        worst = np.maximum.reduceat(best.over, best.rows.lay.first)
        near = np.array([b.root is not None or b.whole for b in best.rows.blocks]) & (worst < NEAR)
        if near.any():
            interior.meet(self.levelling, kept(best.rows, near), best.position[near[best.rows.lay.block]])

    def _results(self) -> list[Fit | None]:
        """The roots' fits, hastened, and with fewer pieces; those that were changed after they had been taken are verified once

        more as a whole.
        """
        found = [_assembled(root) for root in self.roots]
        patched = [i for i, fit in enumerate(found) if fit is not None and self.roots[i].fit is None]
        for i, keeps in zip(patched, self._keep(found, patched), strict=True):
            if not keeps:
                found[i] = None
        have = [i for i, fit in enumerate(found) if fit is not None]
        fits = hastened(self.levelling, [fit for fit in found if fit is not None], [self.roots[i] for i in have])
        allowed = np.array([self.levelling.allowed(i) for i in range(len(found))])
        fewer = fewer_pieces(self.paths, have, fits, self.levelling.limits, self.levelling.kinematics, allowed)
        changed = [k for k in range(len(have)) if len(fewer[k].ticks) < len(fits[k].ticks)]
        for k, keeps in zip(changed, self._keep(fewer, changed, have), strict=True):
            if keeps:
                fits[k] = fewer[k]
        for i, fit in zip(have, fits, strict=True):
            found[i] = fit.moved(-float(self.paths.s_mm[self.paths.first[i]]))
        return found

    def _keep(self, fits: Sequence[Fit | None], which: Sequence[int], roots: Sequence[int] | None = None) -> list[bool]:
        """Whether each of the fits `which` keeps its distance to its path, both ways."""
        chosen = [fit for k in which if (fit := fits[k]) is not None]
        if not chosen:
            return []
        blocks = [self.roots[k if roots is None else roots[k]] for k in which]
        missed, _ = self.levelling.deviations(chosen, blocks)
        return [bool(m.max() <= self.levelling.allowed(b.path)) for m, b in zip(missed, blocks, strict=True)]

    def _next(self, block: Block, draft: tuple[Fit, Mask] | None) -> list[Block]:
        """What to do next about a block that was not taken: itself again, patches of its draft, a wider patch, or nothing."""
        if block.stage >= DROPPED:
            return []
        block.stage += 1
        if block.root is None:
            if block.stage >= STAGES:
                return []
            return self._patched(block, *draft) if draft is not None else [block]
        if block.stage < PATCH_STAGES:
            return [block]
        if block.widened >= 2:
            return self._whole_again(block.root)
        return self._widened(block)

    def _drafts(self, best: Best) -> dict[int, tuple[Fit, Mask]]:
        """The roots whose iterate is good in most places, by number: as a fit, and which knots are not good (with margins)."""
        lay = best.rows.lay
        found: list[tuple[int, slice, Fit]] = []
        for i, block in enumerate(best.rows.blocks):
            if block.root is not None or block.whole or block.stage < 1 or block.fit is not None:
                continue
            rows = slice(int(lay.first[i]), int(lay.first[i]) + int(lay.intervals[i]) + 1)
            if self._widely(best.over[rows] > 1.0).mean() > MOST_BAD:
                continue
            ticks = np.rint(lay.spacing_s[rows][:-1] / TICK_S).astype(np.int64)
            states = np.stack((best.position[rows], best.velocity[rows], best.acceleration[rows]), axis=1)
            states[0], states[-1] = block.start, block.end
            found.append((i, rows, Fit(ticks, states[:, 0], states[:, 1], states[:, 2], best.rows.s[rows])))
        if not found:
            return {}
        blocks = [best.rows.blocks[i] for i, _, _ in found]
        out = {}
        for (i, rows, fit), miss, along in zip(
            found, *self.levelling.deviations([fit for _, _, fit in found], blocks), strict=True
        ):
            block = best.rows.blocks[i]
            bad = best.over[rows] > 1.0
            bad[:-1] |= miss > self.levelling.allowed(block.path)
            wide = self._widely(bad)
            if wide.mean() <= MOST_BAD:
                off = np.hypot(*(best.position[rows] - best.rows.target[rows])[:-1].T)
                along = trusted(along, best.rows.s[rows][:-1], off, block.from_s, block.to_s)
                out[i] = replace(fit, along_mm=np.append(along, block.to_s)), wide
        return out

    def _widely(self, bad: Mask) -> Mask:
        """The bad places with a margin on both sides."""
        return np.asarray(highest_around(bad, 2 * self.margin + 1))

    def _patched(self, block: Block, draft: Fit, bad: Mask) -> list[Block]:
        """Keep the good part of this draft and cut its bad places out."""
        block.draft = draft
        edges = np.flatnonzero(np.diff(np.concatenate(([0], bad.astype(np.int8), [0]))))
        block.slow_from, to = (int(k) for k in np.searchsorted(self.grid.s_mm, (block.from_s, block.to_s)))
        block.slow_before = self.slow[block.slow_from : to].copy()
        block.patches = []
        for low, high in zip(edges[::2], edges[1::2] - 1, strict=True):
            block.patches.append(self._patch(block, int(low), int(high), 0))
        return list(block.patches)

    def _patch(self, root: Block, low: int, high: int, widened: int) -> Block:
        draft = root.draft
        assert draft is not None
        count = len(draft.ticks)
        low, high = max(0, low), min(count, high)
        if high - low < FEWEST_INTERVALS:
            low, high = max(0, low - FEWEST_INTERVALS), min(count, high + FEWEST_INTERVALS)
        start, end = (
            np.stack((draft.position_mm[k], draft.velocity_mm_s[k], draft.acceleration_mm_s2[k])) for k in (low, high)
        )
        from_s = root.from_s if low == 0 else float(draft.along_mm[low])
        to_s = root.to_s if high == count else float(draft.along_mm[high])
        moving_start, moving_end = root.moving_start or low > 0, root.moving_end or high < count
        return Block(root.path, from_s, to_s, start, end, moving_start, moving_end, root, low, high,
                      widened=widened)  # fmt: skip

    def _widened(self, block: Block) -> list[Block]:
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

    def _whole_again(self, root: Block) -> list[Block]:
        """A root whose patches do not come together is done as one, as if there had been none."""
        for patch in root.patches:
            patch.stage = DROPPED
        self.slow[root.slow_from : root.slow_from + len(root.slow_before)] = root.slow_before
        root.patches, root.draft, root.whole = [], None, True
        return [root]

    # --- one stage's system ----------------------------------------------------------------------------------------

    def _places(self, blocks: list[Block]) -> tuple[Grid, Array]:
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

    def _rows(self, blocks: list[Block], remembered: tuple[Array, Array] | None) -> Rows:
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
        wanted = 1.003 * total + 0.5 * self.levelling.ramp_s * (rest_start * 1.0 + rest_end)
        intervals, ticks = knots(wanted, self.spacing_s)
        lay = spline.layout((ticks * TICK_S).astype(np.float64), intervals, self.spacing_s)
        # At a rest the spline lags behind the profile by half the ramp; at a moving end it does not.
        duration = lay.time_s[lay.first + intervals]
        spare = np.where(rest_start & rest_end, duration - total, 0.5 * self.levelling.ramp_s * (rest_start * 1.0 + rest_end))
        head = np.where(rest_start, np.where(rest_end, 0.5, 1.0) * spare, 0.0)
        stretch = (duration - spare) / np.maximum(total, 1e-9)
        t = np.clip((lay.time_s - head[lay.block]) / stretch[lay.block], 0.0, total[lay.block]) + begin[lay.block]
        s = _place(grid, speed, time, t, lay.block)
        lay, s = self._coarsened(blocks, lay, s)
        corner, of = self.levelling.corners_inside(blocks)
        at = (time - begin[grid.path])[np.searchsorted(grid.s_mm, self.paths.s_mm[corner])] * stretch[of] + head[of]
        anchors = self.levelling.anchors(corner, of, at, lay)
        return self.levelling.system(blocks, lay, s, anchors, of, remembered)

    def _coarsened(self, blocks: list[Block], lay: spline.Layout, s: Array) -> tuple[spline.Layout, Array]:
        """Fewer knots where the profile wants little jerk for a while. Patches and stubborn blocks keep all of theirs."""
        path = np.array([b.path for b in blocks])[lay.block]
        point, _ = self.paths.curve(s, path)
        third = np.zeros(len(s))
        third[1:-2] = np.hypot(*(point[3:] - 3.0 * point[2:-1] + 3.0 * point[1:-2] - point[:-3]).T)
        third /= self.levelling.jerk * lay.spacing_s**3
        fine = np.array([b.root is not None or b.stage >= COARSE_STAGES for b in blocks])
        inner = lay.is_interval & (np.arange(len(s)) > lay.first[lay.block]) & ~fine[lay.block]
        third[~(inner & np.append(inner[2:], (False, False)))] = np.inf
        width = 2 * int(np.ceil(self.window_s / self.spacing_s)) + 3
        wanted = highest_around(third, width)
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

    def _slow_down(self, best: Best) -> None:
        """Slow the profile around the places that are over their bounds, more boldly the longer a block has been at it."""
        rows = best.rows
        width = 2 * int(np.ceil(0.5 * self.window_s / self.spacing_s)) + 1
        spread = even_over_three(highest_around(np.maximum(best.over, 1.0), width))
        stage = np.array([b.stage for b in rows.blocks])[rows.lay.block]
        step = np.where(stage < 4, 0.4, np.where(stage < 8, 0.64, 1.0)) * np.log(np.maximum(spread, 1.0))
        patch = np.array([b.root is not None for b in rows.blocks])[rows.lay.block]
        bold = np.maximum(PATCH_GAIN * np.log(np.maximum(spread, 1.0)), PATCH_STEP * (stage + 1))
        step = np.where(patch & (spread > 1.0005), bold, step)
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


def _assembled(root: Block) -> Fit | None:
    """A root's fit: its own, or its draft with every patch put in; None when something is missing."""
    if root.fit is not None or root.draft is None:
        return root.fit
    mended = [(p.low, p.high, p.fit) for p in root.patches if p.fit is not None]
    return spliced(root.draft, mended) if len(mended) == len(root.patches) else None


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
