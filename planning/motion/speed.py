"""How fast the pen may run along its path: caps by corner and curvature, and the fastest profile under them.

The profile bounds acceleration only (jerk is the tube fit's business); it says where knots go in time and how long a stroke
must last.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.motion.limits import Kinematics, Limits
from planning.motion.path import Array, Ints, PathSet

# Caps are looked for at speeds V * 0.65^m.
SPEED_STEP = 0.65
# Curvature leaves at least this part of the acceleration for changing speed.
TANGENTIAL_FLOOR = 0.25


@dataclass(frozen=True, eq=False, slots=True)
class Grid:
    """Places along the paths of a set, in order, where speed is planned: `s_mm`, `path`, `cap_mm_s`, `curvature` (G,); first,

    last (B,).
    """

    s_mm: Array
    path: Ints
    cap_mm_s: Array
    curvature: Array
    first: Ints
    last: Ints


def corner_cap(turn_rad: Array, acceleration: float, tolerance_mm: float) -> Array:
    """Junction-deviation speed: v^2 = A tol s / (1 - s), s = sin((pi - turn) / 2); 0 at a full reversal."""
    s = np.clip(np.cos(np.abs(turn_rad) / 2.0), 0.0, 1.0 - 1e-12)
    return np.asarray(np.sqrt(acceleration * tolerance_mm * s / (1.0 - s)))


def scale_caps(paths: PathSet, limits: Limits, window_s: float) -> Array:
    """The greatest speed at each vertex (N,) at which the path, sampled `window_s` apart, keeps A (2nd) and J (3rd difference).

    Smooth vertices look no further than the nearest corner; those have caps of their own.
    """
    speed, accel, jerk = limits.speed_mm_s, limits.acceleration_mm_s2, limits.jerk_mm_s3
    n = len(paths.s_mm)
    floor = 0.5 * (jerk * limits.tolerance_mm**2) ** (1.0 / 3.0)
    s, path = paths.s_mm, paths.path
    start, end = s[paths.first][path], s[paths.last][path]
    stop = np.where(paths.sharp, s, -np.inf)
    before = np.maximum(np.maximum.accumulate(stop), start)
    stop = np.where(paths.sharp, s, np.inf)
    after = np.minimum(np.minimum.accumulate(stop[::-1])[::-1], end)
    reach = np.where(paths.sharp, np.minimum(s - start, end - s), np.minimum(s - before, after - s))
    leg = np.zeros(n)
    leg[1:-1] = np.minimum(paths.length_mm[:-1], paths.length_mm[1:])
    reach = np.maximum(reach, leg)

    cap = np.full(n, speed)
    inner = np.ones(n, dtype=np.bool_)
    inner[paths.first] = inner[paths.last] = False
    todo = np.flatnonzero(inner & (paths.turn_rad != 0.0))
    last_ratio = np.ones(len(todo))
    v = speed
    while len(todo):
        d = np.minimum(v * window_s, reach[todo])
        span = d / v
        here, low, high = s[todo], start[todo], end[todo]
        p = paths.polyline(here)
        plus, minus = paths.polyline(np.minimum(here + d, high)), paths.polyline(np.maximum(here - d, low))
        second = plus - 2.0 * p + minus
        outer = paths.polyline(np.minimum(here + 1.5 * d, high)) - paths.polyline(np.maximum(here - 1.5 * d, low))
        inner_pair = paths.polyline(np.minimum(here + 0.5 * d, high)) - paths.polyline(np.maximum(here - 0.5 * d, low))
        third = outer - 3.0 * inner_pair
        ratio = np.maximum(
            np.hypot(second[:, 0], second[:, 1]) / (accel * span**2),
            np.hypot(third[:, 0], third[:, 1]) / (1.5 * jerk * span**3),
        )
        fine = ratio <= 1.0
        # Between two levels: log-linear to where the ratio is 1.
        top = np.log(np.maximum(last_ratio[fine], 1.0))
        low_log = -np.log(np.clip(ratio[fine], 1e-3, 1.0))
        share = np.where(top > 0.0, top / np.maximum(top + low_log, 1e-12), 0.0)
        first_level = v == speed
        cap[todo[fine]] = v if first_level else v / SPEED_STEP * SPEED_STEP**share
        todo, last_ratio = todo[~fine], ratio[~fine]
        if v <= floor:
            cap[todo] = floor
            break
        v *= SPEED_STEP
    return np.asarray(np.maximum(cap, min(floor, speed)))


def speed_caps(paths: PathSet, limits: Limits, kinematics: Kinematics, corner_window_s: float) -> tuple[Array, Array]:
    """Caps at the vertices (N,), 0 at the ends, and along the segments (N - 1,), by direction and the motors' step rate."""
    unit = np.diff(paths.point_mm, axis=0) / paths.length_mm[:, None]
    # Between paths that touch there is a void segment without direction.
    steps_per_mm = np.maximum(np.abs(unit @ kinematics.steps_per_mm.T).max(axis=1), 1e-12)
    along = np.minimum(limits.speed_mm_s, kinematics.max_step_rate / steps_per_mm)
    by_scale = scale_caps(paths, limits, 0.6 * corner_window_s)
    by_corner = corner_cap(paths.turn_rad, limits.acceleration_mm_s2, limits.tolerance_mm)
    cap = np.where(paths.sharp, np.minimum(by_corner, np.maximum(by_scale, 0.5 * by_corner)), by_scale)
    cap[1:] = np.minimum(cap[1:], along)
    cap[:-1] = np.minimum(cap[:-1], along)
    cap[paths.first] = 0.0
    cap[paths.last] = 0.0
    return cap, along


def make_grid(paths: PathSet, vertex_cap: Array, segment_cap: Array, limits: Limits, window_s: float) -> Grid:
    """Vertices, points that close in on corners and ends geometrically, and points no further apart than V Te / 4."""
    widest = limits.speed_mm_s * window_s / 4.0
    n = len(paths.s_mm)
    void = np.zeros(n - 1, dtype=np.bool_)
    void[paths.last[:-1]] = True
    length = paths.length_mm
    stops = paths.sharp.copy()
    stops[paths.first] = stops[paths.last] = True
    parts = np.maximum(1, np.ceil(length / widest)).astype(np.int64)
    # Between two places of rest there must be one where the profile moves.
    parts[(parts == 1) & ((length > widest / 4.0) | (stops[:-1] & stops[1:]))] = 2
    parts[void] = 1
    owner = np.repeat(np.arange(n - 1), parts)
    step = np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)
    even = paths.s_mm[owner] + length[owner] * step / parts[owner]
    at = np.flatnonzero(stops)
    ladder = (
        0.4
        * limits.tolerance_mm
        * 1.6 ** np.arange(max(1, int(np.ceil(np.log(widest / (0.4 * limits.tolerance_mm)) / np.log(1.6)))))
    )
    right, left = at[at < n - 1], at[at > 0]
    right, left = right[~void[right]], left[~void[left - 1]]
    up = paths.s_mm[right][:, None] + ladder
    down = paths.s_mm[left][:, None] - ladder
    extra = np.concatenate(
        (up[ladder < 0.5 * length[right][:, None]].ravel(), down[ladder < 0.5 * length[left - 1][:, None]].ravel())
    )
    s = np.unique(np.concatenate((even, paths.s_mm[-1:], extra)))
    close = np.concatenate(([False], np.diff(s) < 1e-9 * (1.0 + s[1:])))
    vertex = np.searchsorted(s, paths.s_mm)
    keep_vertex = np.zeros(len(s), dtype=np.bool_)
    keep_vertex[vertex] = True
    s = s[~close | keep_vertex]
    vertex = np.searchsorted(s, paths.s_mm)

    segment = np.clip(np.searchsorted(paths.s_mm, s, side="right") - 1, 0, n - 2)
    x = np.clip((s - paths.s_mm[segment]) / length[segment], 0.0, 1.0)
    # Along a segment between two smooth vertices their caps run on; a corner's or an end's cap holds at that point alone.
    right_vertex = np.minimum(segment + 1, n - 1)
    between = vertex_cap[segment] + x * (vertex_cap[right_vertex] - vertex_cap[segment])
    cap = np.where(stops[segment] | stops[right_vertex], np.inf, between)
    cap = np.minimum(cap, segment_cap[segment])
    cap[vertex] = vertex_cap
    curvature = np.interp(s, paths.s_mm, paths.curvature)
    return Grid(s, paths.path[segment], cap, curvature, vertex[paths.first], vertex[paths.last])


def fastest(grid: Grid, cap: Array, acceleration: Array, rounds: int = 2, floor: float = TANGENTIAL_FLOOR) -> Array:
    """The fastest speed profile v (G,) under `cap` whose |dv/dt|^2 + (curvature v^2)^2 <= acceleration^2.

    With w = v^2 / 2 and sigma = integral of the tangential acceleration, w - sigma may not rise above any earlier value and
    w + sigma not above any later one: two running minima. Curvature uses the speed of the round before.
    """
    ds = np.diff(grid.s_mm)
    ds[grid.last[:-1]] = 0.0
    decouple = float(cap.max()) ** 2 + 1.0
    top = cap**2 / 2.0
    w = top
    for _ in range(rounds):
        lateral = grid.curvature * 2.0 * w
        tangential = np.sqrt(np.maximum(acceleration**2 - lateral**2, (floor * acceleration) ** 2))
        rise = 0.5 * (tangential[1:] + tangential[:-1]) * ds
        rise[grid.last[:-1]] = decouple
        sigma = np.concatenate(([0.0], np.cumsum(rise)))
        w = np.minimum.accumulate(top - sigma) + sigma
        w = np.minimum.accumulate((w + sigma)[::-1])[::-1] - sigma
        w = np.clip(w, 0.0, top)
    return np.sqrt(2.0 * w)
