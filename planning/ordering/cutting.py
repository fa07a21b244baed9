"""Strokes cut to a greatest length, and the order that lets neighbours dry."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planning.geometry.stroke import Stroke


def cut(stroke: Stroke, max_mm: float) -> list[Stroke]:
    """The stroke in equal pieces, none longer than `max_mm`; they follow each other without a gap."""
    points = stroke.points_mm
    run = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    count = int(np.ceil(run[-1] / max_mm * (1 - 1e-12)))
    if count < 2:
        return [stroke]
    at = run[-1] * np.arange(1, count) / count
    after = np.clip(np.searchsorted(run, at, side="left"), 1, len(run) - 1)  # the vertex at or after each cut
    share = (at - run[after - 1]) / (run[after] - run[after - 1])
    tips = points[after - 1] + share[:, None] * (points[after] - points[after - 1])
    tips[share == 1.0] = points[after[share == 1.0]]
    pieces = []
    heads = np.concatenate((points[:1], tips))
    feet = np.concatenate((tips, points[-1:]))
    first = np.concatenate(([1], after + (share == 1.0)))  # the first vertex strictly inside each piece
    last = np.concatenate((after, [len(points) - 1]))
    for head, foot, a, b in zip(heads, feet, first.tolist(), last.tolist(), strict=True):
        corners = None if stroke.corners is None else np.concatenate(([True], stroke.corners[a:b], [True]))
        pieces.append(Stroke(np.concatenate((head[None], points[a:b], foot[None])), corners, stroke.color))
    return pieces


def interleaved(strokes: Sequence[Stroke]) -> list[Stroke]:
    """Every other stroke on the way out, the rest on the way back and so turned round."""
    back = [stroke.reversed() for stroke in strokes[1::2]]
    return [*strokes[::2], *reversed(back)]
