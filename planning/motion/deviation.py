"""How far a motion and its path are from each other, both ways: no sample of the motion off the path, no vertex of the path

left out.
"""

from __future__ import annotations

import numpy as np

from planning.motion.path import Array, Ints, Mask, PathSet

# Each piece is sampled so that what can happen between samples, |a| dt^2 / 8, is this part of the distance that matters; it
# is added.
BETWEEN = 0.02
FEWEST, MOST = 2, 64
# Neighbours looked at on either side, round after round, while that finds something nearer.
REACH = (1, 2, 3, 4, 6, 8)


def deviation(
    paths: PathSet,
    states: tuple[Array, Array, Array, Array],
    duration_s: Array,
    block: Ints,
    span: tuple[Ints, Array, Array, Array],
    s_guess_mm: Array,
    enough_mm: float,
) -> tuple[Array, Array]:
    """How far each piece (n,) is from its path, and about where along the path it starts; never too small a distance.

    `states` are position, velocity, acceleration and jerk (n, 2) at the pieces' starts. `block` (n,) says to which span a
    piece belongs; `span` is for each: its path, the s it covers from and to, and its last point (B, 2). Pieces of a span
    follow each other, and spans are in order of s. The vertices strictly inside a span count for the piece that comes
    nearest. A distance below `enough_mm` is not looked at more closely.
    """
    q, v, a, j = states
    most = np.hypot(a[:, 0], a[:, 1]) + np.hypot(j[:, 0], j[:, 1]) * duration_s
    count = np.clip(np.ceil(duration_s * np.sqrt(most / (8.0 * BETWEEN * enough_mm))), FEWEST, MOST).astype(np.int64)
    sagitta = most * (duration_s / count) ** 2 / 8.0
    start = np.cumsum(count) - count
    piece = np.repeat(np.arange(len(count)), count)
    x = (np.arange(len(piece)) - start[piece]) / count[piece]
    t = (x * duration_s[piece])[:, None]
    at = q[piece] + t * (v[piece] + t * (a[piece] / 2.0 + t * j[piece] / 6.0))
    last = np.concatenate((block[1:] != block[:-1], [True]))
    next_s = np.where(last, span[2][block], np.concatenate((s_guess_mm[1:], [0.0])))
    guess = s_guess_mm[piece] + x * (next_s - s_guess_mm)[piece]
    off, along = distance_to_path(paths, at, span[0][block[piece]], guess, enough_mm)
    miss = np.maximum.reduceat(off, start) + sagitta

    vertex, owner_span = _inside(paths, span)
    if len(vertex):
        ends = np.concatenate((at[1:], at[-1:]))
        ends[(start + count - 1)[last]] = span[3][block[last]]
        sample_block = block[piece]
        first_sample = np.searchsorted(sample_block, np.arange(len(span[0])))
        last_sample = np.searchsorted(sample_block, np.arange(len(span[0])), side="right") - 1
        near = np.searchsorted(guess, paths.s_mm[vertex]) - 1
        distance, sample = _walk(
            paths.point_mm[vertex], at, ends, near, first_sample[owner_span], last_sample[owner_span], enough_mm
        )
        np.maximum.at(miss, piece[sample], distance + sagitta[piece[sample]])
    return miss, along[start]


def distance_to_path(
    paths: PathSet, at_mm: Array, path: Ints, s_guess_mm: Array, enough_mm: float = 0.0
) -> tuple[Array, Array]:
    """Distance of points (m, 2) to their path's polyline near `s_guess_mm`, and the s of the nearest point found.

    Walks along the segments from the guess while that gets nearer; so the distance is never too small.
    """
    segment = paths.segment(s_guess_mm, path)
    distance, segment = _walk(
        at_mm, paths.point_mm[:-1], paths.point_mm[1:], segment, paths.first[path], paths.last[path] - 1, enough_mm
    )
    chord = paths.point_mm[segment + 1] - paths.point_mm[segment]
    offset = at_mm - paths.point_mm[segment]
    length = paths.length_mm[segment]
    share = np.clip((offset * chord).sum(axis=1) / (length * length), 0.0, 1.0)
    return distance, paths.s_mm[segment] + share * length


def _walk(point: Array, start: Array, end: Array, guess: Ints, low: Ints, high: Ints, enough_mm: float) -> tuple[Array, Ints]:
    """Each point's distance to the nearest chord start[i] - end[i] that is found by walking from i = guess within low ..

    high.
    """
    best_i = np.clip(guess, low, high)
    best = _to_chords(point, start, end, best_i)
    todo = np.arange(len(point))
    for reach in REACH:
        p, centre, down, up = point[todo], best_i[todo], low[todo], high[todo]
        found, found_i = best[todo], centre
        for step in (*range(-reach, 0), *range(1, reach + 1)):
            i = np.clip(centre + step, down, up)
            distance = _to_chords(p, start, end, i)
            nearer = distance < found - 1e-12
            found, found_i = np.where(nearer, distance, found), np.where(nearer, i, found_i)
        best[todo], best_i[todo] = found, found_i
        # Far off, or got nearer: look around there once more. The rest has found what there is.
        todo = todo[(found > enough_mm) & ((found_i != centre) | (reach < REACH[-1] and found > 2.0 * enough_mm))]
        if not len(todo):
            break
    return best, best_i


def _to_chords(point: Array, start: Array, end: Array, i: Ints) -> Array:
    chord, offset = end[i] - start[i], point - start[i]
    square = chord[:, 0] ** 2 + chord[:, 1] ** 2
    share = np.clip((offset[:, 0] * chord[:, 0] + offset[:, 1] * chord[:, 1]) / np.maximum(square, 1e-300), 0.0, 1.0)
    return np.asarray(np.hypot(offset[:, 0] - share * chord[:, 0], offset[:, 1] - share * chord[:, 1]))


def _inside(paths: PathSet, span: tuple[Ints, Array, Array, Array]) -> tuple[Ints, Ints]:
    """The vertices strictly inside the spans, and which span each is in."""
    which = np.searchsorted(span[1], paths.s_mm, side="right") - 1
    inside: Mask = (which >= 0) & (paths.s_mm > span[1][which] + 1e-9) & (paths.s_mm < span[2][which] - 1e-9)
    vertex = np.flatnonzero(inside)
    return vertex, which[vertex]
