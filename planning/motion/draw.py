"""Motions for strokes: the tube where it fits, a straight profile for a line, stops at every vertex where nothing else can be

found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from planning.errors import ImpossiblePlan
from planning.geometry.stroke import Stroke
from planning.motion.deviation import deviation
from planning.motion.fit import Fit
from planning.motion.limits import Kinematics, Limits
from planning.motion.path import Array, Ints, Mask, path_set, thinned, thinning_mm
from planning.motion.plan import TICK_S, Motion, still
from planning.motion.speed import speed_caps
from planning.motion.travel import straight
from planning.motion.tube import Section, Tuning, fit_sections, knot_spacing_s

# A longer stroke is planned in windows: memory and work then grow with the window.
WINDOW_VERTICES = 1500
WINDOW_S = 15.0
# Constant speed: steps of speed, the least share of the limit, and how much of a corner's cap the jerk limit leaves.
EVEN_STEP, EVEN_FLOOR, EVEN_SHARE = 0.8, 0.1, 0.7


@dataclass(frozen=True, eq=False, slots=True)
class _Work:
    """A stroke that wants the tube: its place in the batch, its thinned vertices and their corner marks, and what thinning

    may cost.
    """

    place: int
    points: Array
    corners: Mask | None
    slack_mm: float


def draw_motions(strokes: Sequence[Stroke], limits: Limits, kinematics: Kinematics, first_number: int = 0) -> list[Motion]:
    """A motion for each stroke, in order, from its first point to its last. `first_number` is the first stroke's number, for
    errors.

    Raises ImpossiblePlan naming the stroke that cannot be planned.
    """
    out: list[Motion | None] = [None] * len(strokes)
    work: list[_Work] = []
    for i, stroke in enumerate(strokes):
        try:
            simple = _simple(stroke, limits, kinematics)
        except ImpossiblePlan as error:
            raise ImpossiblePlan(f"stroke {first_number + i}: {error}") from error
        if isinstance(simple, Motion):
            out[i] = simple
        else:
            corners = None if stroke.corners is None else stroke.corners[simple]
            slack = thinning_mm(limits.tolerance_mm) if len(simple) < len(stroke.points_mm) else 0.0
            work.append(_Work(i, np.ascontiguousarray(stroke.points_mm[simple]), corners, slack))
    together = [w for w in work if not _is_long(w.points, limits)]
    sections = [Section(w.points, w.corners, slack_mm=w.slack_mm) for w in together]
    for w, fit in zip(together, _fit(sections, limits, kinematics), strict=True):
        out[w.place] = _motion_of([fit], w.points) if fit is not None else legs(w.points, limits, kinematics)
    for w in work:
        if out[w.place] is None:
            out[w.place] = _windowed(w, limits, kinematics)
    missing = [first_number + i for i, motion in enumerate(out) if motion is None]
    if missing:
        raise ImpossiblePlan(f"stroke {missing[0]} could not be planned; lower the speed or widen the path tolerance")
    return [motion for motion in out if motion is not None]


def even_motions(strokes: Sequence[Stroke], limits: Limits, kinematics: Kinematics, first_number: int = 0) -> list[Motion]:
    """As draw_motions, each stroke as even in speed as its bends allow: no faster anywhere than where it must be slowest.

    A stroke whose corners would make it slower than EVEN_FLOOR of the speed limit runs at that speed and slows down for them.
    Speeds are rounded down to steps of EVEN_STEP, so that strokes can be planned together.
    """
    step = [_even_step(stroke, limits, kinematics) for stroke in strokes]
    out: list[Motion | None] = [None] * len(strokes)
    for k in sorted(set(step)):
        mine = [i for i, own in enumerate(step) if own == k]
        slower = replace(limits, speed_mm_s=limits.speed_mm_s * EVEN_STEP**k)
        for i, motion in zip(mine, draw_motions([strokes[i] for i in mine], slower, kinematics, first_number), strict=True):
            out[i] = motion
    return [motion for motion in out if motion is not None]


def _even_step(stroke: Stroke, limits: Limits, kinematics: Kinematics) -> int:
    """How many steps below the limit the speed is that the whole stroke can keep, its ends aside."""
    kept = thinned(stroke.points_mm, thinning_mm(limits.tolerance_mm))
    if len(kept) < 3:
        return 0
    corners = None if stroke.corners is None else stroke.corners[kept]
    paths = path_set([stroke.points_mm[kept]], [corners], limits.tolerance_mm)
    cap, _ = speed_caps(paths, limits, kinematics, limits.acceleration_mm_s2 / limits.jerk_mm_s3)
    slowest = EVEN_SHARE * float(cap[1:-1].min())
    share = min(1.0, max(EVEN_FLOOR, slowest / limits.speed_mm_s))
    return int(np.ceil(np.log(share) / np.log(EVEN_STEP) - 1e-9))


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


def _motion_of(fits: Sequence[Fit], points: Array) -> Motion:
    """Fits that follow each other, joined."""
    duration = np.concatenate([f.ticks for f in fits]) * TICK_S
    position = np.concatenate([f.position_mm[:-1] for f in fits])
    velocity = np.concatenate([f.velocity_mm_s[:-1] for f in fits])
    acceleration = np.concatenate([f.acceleration_mm_s2[:-1] for f in fits])
    after = np.concatenate((acceleration[1:], fits[-1].acceleration_mm_s2[-1:]))
    jerk = (after - acceleration) / duration[:, None]
    return Motion(duration, position, velocity, acceleration, jerk, np.array(points[-1], dtype=np.float64))


def legs(points: Array, limits: Limits, kinematics: Kinematics) -> Motion:
    """The last resort: from rest to rest along every segment."""
    legs = [_line(a, b, limits, kinematics) for a, b in pairwise(points)]
    join = [np.concatenate([getattr(leg, name) for leg in legs]) for name in
            ("duration_s", "position_mm", "velocity_mm_s", "acceleration_mm_s2", "jerk_mm_s3")]  # fmt: skip
    return Motion(join[0], join[1], join[2], join[3], join[4], np.array(points[-1], dtype=np.float64))


# --- windows -----------------------------------------------------------------------------------------------------------


def _is_long(points: Array, limits: Limits) -> bool:
    length = float(np.hypot(*np.diff(points, axis=0).T).sum())
    return len(points) > 2 * WINDOW_VERTICES or length > 2.0 * WINDOW_S * limits.speed_mm_s


def _windowed(work: _Work, limits: Limits, kinematics: Kinematics) -> Motion:
    """Plan a window from a moving start to a rest ahead, keep all but the braking before that rest, and go on from there."""
    points = work.points
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    ahead = 2.0 * limits.speed_mm_s / limits.acceleration_mm_s2 + 4.0 * limits.acceleration_mm_s2 / limits.jerk_mm_s3 + 0.1
    # What lies behind a window's start is still needed to judge the bends around it.
    context = limits.speed_mm_s * (limits.acceleration_mm_s2 / limits.jerk_mm_s3 + 0.02)
    fits: list[Fit] = []
    start = 0
    at_mm = 0.0
    state: Array | None = None
    vertices = WINDOW_VERTICES
    while True:
        furthest = at_mm + WINDOW_S * limits.speed_mm_s * vertices / WINDOW_VERTICES
        reach = int(np.searchsorted(along, furthest, side="right"))
        here = int(np.searchsorted(along, at_mm, side="right"))
        end = min(len(points), here + vertices, max(reach + 1, here + 2))
        if len(points) - end < vertices // 8:
            end = len(points)
        corners = None if work.corners is None else work.corners[start:end]
        section = Section(points[start:end], corners, state, at_mm - along[start], work.slack_mm)
        (fit,) = _fit([section], limits, kinematics)
        final = end == len(points)
        if fit is None:
            if vertices > 64 * WINDOW_VERTICES or final:
                return legs(points, limits, kinematics)
            vertices *= 2
            continue
        if final:
            fits.append(fit.moved(float(along[start])))
            break
        cut = _cut(fit, ahead, limits)
        if cut is None:
            vertices *= 2
            continue
        fits.append(fit.between(0, cut).moved(float(along[start])))
        state = np.stack((fit.position_mm[cut], fit.velocity_mm_s[cut], fit.acceleration_mm_s2[cut]))
        at_mm = float(fit.along_mm[cut] + along[start])
        start = max(0, int(np.searchsorted(along, at_mm - context, side="right")) - 1)
        vertices = WINDOW_VERTICES
    motion = _motion_of(fits, points)
    return motion if _verified(motion, work, limits, fits) else legs(points, limits, kinematics)


def _cut(fit: Fit, ahead_s: float, limits: Limits) -> int | None:
    """The calmest knot with at least `ahead_s` of the window after it, or None when the window is too short to have one."""
    time = np.concatenate(([0.0], np.cumsum(fit.ticks * TICK_S)))
    latest = time[-1] - ahead_s
    if latest < ahead_s:
        return None
    choice = np.flatnonzero((time >= latest - 0.5 * ahead_s) & (time <= latest))
    acceleration = np.hypot(*fit.acceleration_mm_s2[choice].T) / limits.acceleration_mm_s2
    return int(choice[np.argmin(acceleration)])


def _verified(motion: Motion, work: _Work, limits: Limits, fits: Sequence[Fit]) -> bool:
    """The whole of a windowed stroke against its path, both ways."""
    paths = path_set([work.points], [work.corners], limits.tolerance_mm)
    pieces = (motion.position_mm, motion.velocity_mm_s, motion.acceleration_mm_s2, motion.jerk_mm_s3)
    guess = np.concatenate([f.along_mm[:-1] for f in fits])
    span = (np.zeros(1, dtype=np.int64), np.zeros(1), paths.s_mm[-1:], motion.end_mm[None, :])
    block = np.zeros(len(motion), dtype=np.int64)
    miss, _ = deviation(paths, pieces, motion.duration_s, block, span, guess, 0.8 * limits.tolerance_mm)
    return bool(miss.max() <= limits.tolerance_mm - work.slack_mm)
