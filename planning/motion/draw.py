"""Motions for strokes: the tube where it fits, a straight profile for a line, stops at every vertex where nothing else can be
found. A long stroke comes in parts, as they are planned."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from planning.errors import ImpossiblePlan
from planning.geometry.stroke import Stroke
from planning.motion.deviation import deviation
from planning.motion.fit import Fit
from planning.motion.limits import Kinematics, Limits
from planning.motion.path import Array, Ints, Mask, PathSet, path_set, thinned, thinning_mm
from planning.motion.plan import TICK_S, Motion, joined_motion, still
from planning.motion.speed import speed_caps
from planning.motion.travel import straight
from planning.motion.tube import Section, Tuning, fit_sections, knot_spacing_s
from planning.motion.windows import highest_around

# A longer stroke is planned in windows: memory and work then grow with the window, and its first part is out soon.
LONG_VERTICES, LONG_S = 600, 10.0
# A stroke that is waited for is long earlier.
SOON_VERTICES = 200
WINDOW_VERTICES, WINDOW_S = 1500, 15.0
# The first window is this part of a full one; each is twice as large as the one before.
FIRST_WINDOW = 0.125
# A part lasts at least about this long, so that the next can be planned meanwhile.
LEAST_PART_S = 1.0
# Places looked at to cut a window.
MOST_CUTS = 8
# Constant speed: steps of speed, the least share of the limit, and how much of a corner's cap the jerk limit leaves.
EVEN_STEP, EVEN_FLOOR, EVEN_SHARE = 0.8, 0.1, 0.7


@dataclass(frozen=True, eq=False, slots=True)
class _Work:
    """A stroke that wants the tube: its thinned vertices, their corner marks, and what thinning may cost."""

    points: Array
    corners: Mask | None
    slack_mm: float


def draw_parts(
    strokes: Sequence[Stroke],
    limits: Limits,
    kinematics: Kinematics,
    first_number: int = 0,
    even: bool = False,
    *,
    soon: bool = False,
) -> Iterator[tuple[int, Motion, bool]]:
    """Motions for all strokes, in order: the stroke's index, a part of its motion, and whether that is its last part.

    The first part starts at rest at the stroke's first point, the last ends at rest at its last; parts in between start with
    exactly the state with which the one before ended. Short strokes are planned together at once and come whole; a long one
    is planned window by window, when its turn comes. `even` keeps each stroke's speed as even as its bends allow: no faster
    anywhere than where it must be slowest, and no slower for that than EVEN_FLOOR of the speed limit. `soon` is for strokes of
    which the first is waited for.

    Raises ImpossiblePlan naming the stroke that cannot be planned, counted from `first_number`.
    """
    own = [_even_limits(stroke, limits, kinematics) if even else limits for stroke in strokes]
    simple: dict[int, Motion] = {}
    work: dict[int, _Work] = {}
    for i, stroke in enumerate(strokes):
        with _naming(first_number + i):
            found = _simple(stroke, own[i], kinematics)
            if isinstance(found, Motion):
                simple[i] = found
                continue
        corners = None if stroke.corners is None else stroke.corners[found]
        slack = thinning_mm(limits.tolerance_mm) if len(found) < len(stroke.points_mm) else 0.0
        work[i] = _Work(np.ascontiguousarray(stroke.points_mm[found]), corners, slack)
    together = [
        i for i, w in work.items() if not _is_long(w.points, own[i], SOON_VERTICES if soon and i == 0 else LONG_VERTICES)
    ]
    for speed in sorted({own[i].speed_mm_s for i in together}, reverse=True):
        mine = [i for i in together if own[i].speed_mm_s == speed]
        sections = [Section(work[i].points, work[i].corners, slack_mm=work[i].slack_mm) for i in mine]
        for i, fit in zip(mine, _fit(sections, own[mine[0]], kinematics), strict=True):
            with _naming(first_number + i):
                simple[i] = _motion_of(fit, work[i].points[-1]) if fit else legs(work[i].points, own[i], kinematics)
    for i in range(len(strokes)):
        if i in simple:
            yield i, simple.pop(i), True
            continue
        with _naming(first_number + i):
            for motion, last in _windowed(work.pop(i), own[i], kinematics):
                yield i, motion, last


def draw_motions(
    strokes: Sequence[Stroke], limits: Limits, kinematics: Kinematics, first_number: int = 0, even: bool = False
) -> list[Motion]:
    """As draw_parts, the parts of each stroke joined."""
    parts: list[list[Motion]] = [[] for _ in strokes]
    for i, motion, _ in draw_parts(strokes, limits, kinematics, first_number, even):
        parts[i].append(motion)
    return [joined_motion(some) for some in parts]


@contextmanager
def _naming(number: int) -> Iterator[None]:
    try:
        yield
    except ImpossiblePlan as error:
        raise ImpossiblePlan(f"stroke {number + 1}: {error}") from error


def _even_limits(stroke: Stroke, limits: Limits, kinematics: Kinematics) -> Limits:
    """The limits with the speed that the whole stroke can keep, its ends aside; rounded down to steps of EVEN_STEP, so that

    strokes can be planned together.
    """
    kept = thinned(stroke.points_mm, thinning_mm(limits.tolerance_mm))
    if len(kept) < 3:
        return limits
    corners = None if stroke.corners is None else stroke.corners[kept]
    paths = path_set([stroke.points_mm[kept]], [corners], limits.tolerance_mm)
    cap, _ = speed_caps(paths, limits, kinematics, limits.acceleration_mm_s2 / limits.jerk_mm_s3)
    slowest = EVEN_SHARE * float(cap[1:-1].min())
    share = min(1.0, max(EVEN_FLOOR, slowest / limits.speed_mm_s))
    return replace(limits, speed_mm_s=limits.speed_mm_s * EVEN_STEP ** int(np.ceil(np.log(share) / np.log(EVEN_STEP) - 1e-9)))


def _simple(stroke: Stroke, limits: Limits, kinematics: Kinematics) -> Motion | Ints:
    """The motion of a dot, a line, or a stroke too small for the tube to matter; otherwise the vertices worth planning."""
    points = stroke.points_mm
    first, last = points[0], points[-1]
    size = float(np.hypot(*(points.max(axis=0) - points.min(axis=0))))
    if size <= 0.5 * limits.tolerance_mm:
        return _line(first, last, limits, kinematics) if (first != last).any() else still(last)
    kept = thinned(points, thinning_mm(limits.tolerance_mm))
    if len(points) == 2:
        return _line(first, last, limits, kinematics)
    return kept


def _line(start: Array, end: Array, limits: Limits, kinematics: Kinematics) -> Motion:
    way = end - start
    speed = min(limits.speed_mm_s, kinematics.max_speed_mm_s(way / np.hypot(*way)))
    return straight(start, end, speed, limits.acceleration_mm_s2, limits.jerk_mm_s3)


def _fit(sections: Sequence[Section], limits: Limits, kinematics: Kinematics) -> list[Fit | None]:
    """The tube for all sections; those it cannot do are tried again more carefully."""
    fits = fit_sections(sections, limits, kinematics)
    spacing = knot_spacing_s(limits)
    for tuning in (Tuning(spacing, 0.5), Tuning(max(0.002, 0.5 * spacing), 0.25)):
        failed = [i for i, fit in enumerate(fits) if fit is None]
        if not failed:
            break
        again = fit_sections([sections[i] for i in failed], limits, kinematics, tuning)
        for i, fit in zip(failed, again, strict=True):
            fits[i] = fit
    return fits


def _motion_of(fit: Fit, end_mm: Array) -> Motion:
    """The motion of a fit, ending at exactly `end_mm` (2,)."""
    duration = (fit.ticks * TICK_S).astype(np.float64)
    jerk = np.diff(fit.acceleration_mm_s2, axis=0) / duration[:, None]
    return Motion(duration, fit.position_mm[:-1], fit.velocity_mm_s[:-1], fit.acceleration_mm_s2[:-1], jerk,
                  np.array(end_mm, dtype=np.float64))  # fmt: skip


def legs(points: Array, limits: Limits, kinematics: Kinematics) -> Motion:
    """The last resort: from rest to rest along every segment."""
    return joined_motion([_line(a, b, limits, kinematics) for a, b in pairwise(points)])


# --- windows -----------------------------------------------------------------------------------------------------------


def _is_long(points: Array, limits: Limits, vertices: int) -> bool:
    length = float(np.hypot(*np.diff(points, axis=0).T).sum())
    return len(points) > vertices or length > LONG_S * limits.speed_mm_s


def _windowed(work: _Work, limits: Limits, kinematics: Kinematics) -> Iterator[tuple[Motion, bool]]:
    """Plan a window from a moving start to a rest ahead, keep all but the braking before that rest, and go on from there.

    Yields parts of the motion, and whether they are the last. The braking is kept until the next window is planned: where that
    fails, the pen stops as it had been planned to, and goes on from rest.
    """
    points = work.points
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    ahead = 2.0 * limits.speed_mm_s / limits.acceleration_mm_s2 + 4.0 * limits.acceleration_mm_s2 / limits.jerk_mm_s3 + 0.1
    # What lies behind a window's start is still needed to judge the bends around it.
    context = limits.speed_mm_s * (limits.acceleration_mm_s2 / limits.jerk_mm_s3 + 0.02)
    start, at_mm, size = 0, 0.0, FIRST_WINDOW
    state: Array | None = None
    braking: tuple[Fit, int] | None = None
    while True:
        end = _window_end(along, at_mm, size, limits)
        final = end == len(points)
        corners = None if work.corners is None else work.corners[start:end]
        section = Section(points[start:end], corners, state, at_mm - along[start], work.slack_mm)
        (fit,) = _fit([section], limits, kinematics)
        if fit is None:
            if braking is not None:
                rest, end = braking
                yield _motion_of(rest, points[end - 1]), end == len(points)
            else:
                yield legs(points[start:end], limits, kinematics), final
            if end == len(points):
                return
            start, at_mm, state, braking = end - 1, float(along[end - 1]), None, None
            continue
        if final:
            yield _motion_of(fit, points[-1]), True
            return
        cut = _cut(section, fit, ahead, limits)
        if cut is None:
            size *= 2.0
            continue
        yield _motion_of(fit.between(0, cut), fit.position_mm[cut]), False
        braking = fit.between(cut, len(fit.ticks)), end
        state = np.stack((fit.position_mm[cut], fit.velocity_mm_s[cut], fit.acceleration_mm_s2[cut]))
        at_mm = float(fit.along_mm[cut] + along[start])
        start = max(0, int(np.searchsorted(along, at_mm - context, side="right")) - 1)
        size = min(1.0, 2.0 * size)


def _window_end(along: Array, at_mm: float, size: float, limits: Limits) -> int:
    """One past the last vertex of a window of `size` (1: full size) from `at_mm`; the stroke's end when little is left."""
    vertices = int(size * WINDOW_VERTICES)
    here = int(np.searchsorted(along, at_mm, side="right"))
    reach = int(np.searchsorted(along, at_mm + size * WINDOW_S * limits.speed_mm_s, side="right"))
    end = min(len(along), here + vertices, max(reach + 1, here + 2))
    return len(along) if len(along) - end < vertices // 8 else end


def _cut(section: Section, fit: Fit, ahead_s: float, limits: Limits) -> int | None:
    """The calmest knot with at least `ahead_s` of the window after it, up to which the fit has visited its path.

    None when the window is too short to have one.
    """
    time = np.concatenate(([0.0], np.cumsum(fit.ticks * TICK_S)))
    latest = time[-1] - ahead_s
    if latest < max(ahead_s, LEAST_PART_S):
        return None
    paths = path_set([section.points_mm], [section.corners], limits.tolerance_mm)
    # Calm around the knot too: whoever makes commands of the motion may not want one to end just here.
    acceleration = highest_around(np.hypot(*fit.acceleration_mm_s2.T), 5)
    choice = np.flatnonzero((time >= latest - 0.5 * ahead_s) & (time <= latest))
    for cut in choice[np.argsort(acceleration[choice])][:MOST_CUTS].tolist():
        # What it leaves out is beside its last pieces; those before them are as good as the fit, which has been judged.
        tail = int(np.searchsorted(time, time[cut] - ahead_s))
        if _visits(paths, fit.between(tail, cut), section, limits):
            return int(cut)
    return None


def _visits(paths: PathSet, fit: Fit, section: Section, limits: Limits) -> bool:
    """True when the fit leaves out nothing of its path from where it begins to where it ends."""
    span = (np.zeros(1, dtype=np.int64), fit.along_mm[:1], fit.along_mm[-1:], fit.position_mm[-1:])
    h = (fit.ticks * TICK_S).astype(np.float64)
    jerk = np.diff(fit.acceleration_mm_s2, axis=0) / h[:, None]
    pieces = (fit.position_mm[:-1], fit.velocity_mm_s[:-1], fit.acceleration_mm_s2[:-1], jerk)
    block = np.zeros(len(h), dtype=np.int64)
    miss, _ = deviation(paths, pieces, h, block, span, fit.along_mm[:-1], 0.8 * limits.tolerance_mm)
    return bool(miss.max() <= limits.tolerance_mm - section.slack_mm)
