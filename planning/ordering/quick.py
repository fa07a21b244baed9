"""The questions that are asked of every stroke several times, answered without numpy where one look at the ends will do."""

from __future__ import annotations

from planning.geometry.stroke import Stroke


def _ends_meet(stroke: Stroke) -> bool:
    points = stroke.points_mm
    return bool(points[0, 0] == points[-1, 0] and points[0, 1] == points[-1, 1])


def is_dot(stroke: Stroke) -> bool:
    """`Stroke.is_dot`."""
    points = stroke.points_mm
    if len(points) == 1:
        return True
    if points[0, 0] != points[1, 0] or points[0, 1] != points[1, 1]:
        return False
    return stroke.is_dot


def is_closed(stroke: Stroke) -> bool:
    """`Stroke.is_closed`."""
    return len(stroke.points_mm) > 2 and _ends_meet(stroke)
