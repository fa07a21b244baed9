"""Commands to absolute segments: lines, quadratics, cubics and elliptical arcs, many paths at once.

An arc keeps its centre and two axis vectors, so that an affine map acts on it exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plotter.svg.path_tokens import LOWER, UPPER, Commands, M, Z

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

LINE, QUADRATIC, CUBIC, ARC = range(4)

# Running sums keep their whole part in integers of this many units, so that sums over millions of commands stay exact.
_GRAIN = 2.0**-20
_GRAIN_LIMIT = 2.0**40


@dataclass(frozen=True, eq=False, slots=True)
class Segments:
    """Segments in drawing order, user units.

    `kind` (n,); `points` (n, 4, 2): start, two controls (of a quadratic only the first counts), end; `subpath` (n,) into
    the subpaths; `closing` (n,) True for the line that a close command draws. Arcs, in the order of their segments: `centre`,
    `axis_u`, `axis_v` (m, 2), `angle` and `sweep` (m,) radians; a point is centre + cos(t) u + sin(t) v.
    Subpaths: `path` (k,), `start` (k, 2), `closed` (k,), `drawn` (k,) True where any command follows the move.
    """

    kind: NDArray[np.uint8]
    points: Floats
    subpath: Ints
    closing: Bools
    centre: Floats
    axis_u: Floats
    axis_v: Floats
    angle: Floats
    sweep: Floats
    path: Ints
    start: Floats
    closed: Bools
    drawn: Bools


def resolve(commands: Commands) -> Segments:
    """Absolute segments of `commands`. Numbers must be finite."""
    code = commands.code
    upper = np.bitwise_and(code, np.uint8(UPPER))
    relative = (code & LOWER) != 0
    is_move = upper == M
    sub = np.cumsum(is_move) - 1
    position, start = _positions(commands, upper, relative, is_move, sub)
    previous = np.empty_like(position)
    previous[1:] = position[:-1]
    previous[:1] = 0.0
    base = np.where(relative[:, None], previous, 0.0)

    points = np.empty((len(code), 4, 2))
    points[:, 0] = points[:, 1] = previous
    points[:, 2] = points[:, 3] = position
    kind = np.zeros(len(code), np.uint8)
    _cubics(commands, upper, base, points, kind)
    _quadratics(commands, upper, base, points, kind)
    arcs = _arcs(commands, upper, points, kind)

    keep = ~is_move
    first = np.flatnonzero(is_move)
    last = _last_of(first, len(code))
    return Segments(
        kind[keep],
        points[keep],
        sub[keep],
        upper[keep] == Z,
        *arcs,
        path=commands.path[first],
        start=start,
        closed=upper[last] == Z,
        drawn=last > first,
    )


def _last_of(first: Ints, total: int) -> Ints:
    return np.append(first[1:], total)[: len(first)] - 1


def _chain(values: Floats, anchored: Bools) -> tuple[Floats, Ints]:
    """x[i] = values[i] where anchored (the first must be), else x[i-1] + values[i]; and the index of each x's anchor."""
    if anchored.all():
        return values, np.arange(len(values))
    anchor = np.maximum.accumulate(np.where(anchored, np.arange(len(values)), 0))
    delta = np.where(anchored, 0.0, values)
    if float(np.abs(delta).max(initial=0.0)) * max(1, len(delta)) > _GRAIN_LIMIT:
        total = np.cumsum(delta)
        return values[anchor] + (total - total[anchor]), anchor
    whole = np.rint(delta / _GRAIN).astype(np.int64)
    rest = np.cumsum(delta - whole * _GRAIN)
    total_whole = np.cumsum(whole)
    return values[anchor] + ((total_whole - total_whole[anchor]) * _GRAIN + (rest - rest[anchor])), anchor


# Which argument of a command is its end point's x; y follows it.
_END_ARGUMENT = {"M": 0, "L": 0, "T": 0, "C": 4, "S": 2, "Q": 2, "A": 5}


def _positions(
    commands: Commands, upper: NDArray[np.uint8], relative: Bools, is_move: Bools, sub: Ints
) -> tuple[Floats, Floats]:
    """Where each command ends (n, 2), and where each subpath starts (k, 2).

    A subpath is first reckoned from its own start, as if that were 0; absolute coordinates anchor it to the page. Then the
    starts are chained: each rests on the end of the subpath before, or on its start where that one was closed.
    """
    offset = np.full(256, -1)
    for letter, place in _END_ARGUMENT.items():
        offset[ord(letter)] = place
    first_of = np.flatnonzero(is_move)
    last_of = _last_of(first_of, len(upper))
    closed = upper[last_of] == Z
    fresh = np.diff(commands.path[first_of], prepend=-1) != 0
    padded = np.append(commands.numbers, 0.0)
    position = np.empty((len(upper), 2))
    start = np.empty((len(first_of), 2))
    for axis in (0, 1):
        single = b"HV"[axis]
        given = offset[upper] >= 0
        index = commands.first + np.where(given, offset[upper] + axis, 0)
        given |= upper == single
        value = np.where(given, padded[np.where(given, index, -1)], 0.0)
        move_value = value[first_of]
        value[first_of] = 0.0
        local, anchor = _chain(value, (given & ~relative) | is_move)
        on_page = anchor != first_of[sub]
        before = np.roll(last_of, 1)
        before_closed = np.roll(closed, 1)
        before_local = np.where(before_closed, 0.0, local[before])
        before_fixed = on_page[before] & ~before_closed
        absolute = fresh | ~relative[first_of]
        begin = _chain(
            move_value + np.where(absolute, 0.0, before_local),
            absolute | before_fixed,
        )[0]
        start[:, axis] = begin
        position[:, axis] = np.where(on_page, local, local + begin[sub])
        position[last_of[closed], axis] = begin[closed]
    return position, start


def _gather(commands: Commands, rows: Ints, count: int) -> Floats:
    return np.asarray(commands.numbers[commands.first[rows][:, None] + np.arange(count)])


def _cubics(commands: Commands, upper: NDArray[np.uint8], base: Floats, points: Floats, kind: NDArray[np.uint8]) -> None:
    full, smooth = np.flatnonzero(upper == ord("C")), np.flatnonzero(upper == ord("S"))
    kind[full] = kind[smooth] = CUBIC
    values = _gather(commands, full, 4)
    points[full, 1] = values[:, :2] + base[full]
    points[full, 2] = values[:, 2:] + base[full]
    points[smooth, 2] = _gather(commands, smooth, 2) + base[smooth]
    after_cubic = kind[smooth - 1] == CUBIC
    points[smooth, 1] = points[smooth, 0]
    reflected = smooth[after_cubic]
    points[reflected, 1] = 2 * points[reflected, 0] - points[reflected - 1, 2]


def _quadratics(commands: Commands, upper: NDArray[np.uint8], base: Floats, points: Floats, kind: NDArray[np.uint8]) -> None:
    full, smooth = np.flatnonzero(upper == ord("Q")), np.flatnonzero(upper == ord("T"))
    kind[full] = kind[smooth] = QUADRATIC
    points[full, 1] = _gather(commands, full, 2) + base[full]
    if not len(smooth):
        return
    # q[i] = 2 p[i] - q[i-1]: with alternating signs a running sum, anchored at every Q and wherever T follows no quadratic.
    rows = np.flatnonzero(kind == QUADRATIC)
    is_full = upper[rows] == ord("Q")
    follows = kind[rows - 1] == QUADRATIC
    sign = np.where(np.arange(len(rows)) % 2 == 0, 1.0, -1.0)
    for axis in (0, 1):
        known = np.where(is_full, points[rows, 1, axis], points[rows, 0, axis])
        anchored = is_full | ~follows
        signed = _chain(np.where(anchored, sign * known, sign * 2 * points[rows, 0, axis]), anchored)[0]
        points[rows, 1, axis] = np.where(is_full, known, sign * signed)


def _arcs(
    commands: Commands, upper: NDArray[np.uint8], points: Floats, kind: NDArray[np.uint8]
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Endpoint to centre form (SVG 2, B.2.4 and B.2.5). Arcs without a radius become lines, arcs to their start nothing."""
    rows = np.flatnonzero(upper == ord("A"))
    values = _gather(commands, rows, 5)
    radius = np.abs(values[:, :2])
    begin, end = points[rows, 0], points[rows, 3]
    real = (radius > 0).all(axis=1) & (begin != end).any(axis=1)
    rows, values, radius, begin, end = rows[real], values[real], radius[real], begin[real], end[real]
    kind[rows] = ARC
    turn = np.radians(values[:, 2] % 360.0)
    cos, sin = np.cos(turn), np.sin(turn)
    half = (begin - end) / 2
    x = (cos * half[:, 0] + sin * half[:, 1]) / radius[:, 0]
    y = (-sin * half[:, 0] + cos * half[:, 1]) / radius[:, 1]
    reach = np.hypot(x, y)
    radius *= np.maximum(reach, 1.0)[:, None]
    x, y = x / np.maximum(reach, 1.0), y / np.maximum(reach, 1.0)
    # On the unit circle: the chord's half length is h <= 1 and the centre lies sqrt(1 - h^2) off its middle.
    h = np.minimum(np.hypot(x, y), 1.0)
    off = np.sqrt((1.0 - h) * (1.0 + h)) / h
    large, positive = values[:, 3] != 0, values[:, 4] != 0
    off = np.where(large == positive, -off, off)
    cx, cy = off * y, -off * x
    angle = np.arctan2(y - cy, x - cx)
    sweep = np.arctan2(-y - cy, -x - cx) - angle
    sweep = np.where(positive & (sweep <= 0), sweep + 2 * np.pi, sweep)
    sweep = np.where(~positive & (sweep >= 0), sweep - 2 * np.pi, sweep)
    axis_u = np.stack((radius[:, 0] * cos, radius[:, 0] * sin), axis=1)
    axis_v = np.stack((-radius[:, 1] * sin, radius[:, 1] * cos), axis=1)
    centre = (begin + end) / 2 + cx[:, None] * axis_u + cy[:, None] * axis_v
    return centre, axis_u, axis_v, angle, sweep
