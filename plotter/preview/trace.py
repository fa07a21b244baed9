"""From a plan's actions to plain polylines: where the pen goes, down and up, close enough to look at and to measure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely

from planning.geometry.stroke import Points
from planning.motion.plan import Action, Draw, LayerStart, Motion, Travel

# Told apart on white paper, and by people who do not see red and green apart.
PALETTE = ("#222222", "#0072b2", "#d55e00", "#009e73", "#aa4499", "#8c6d1f", "#56a0d3", "#882255")


@dataclass(frozen=True, eq=False, slots=True)
class Line:
    """A pen-down polyline (n, 2), n >= 1, in machine millimetres, its colour `#rrggbb` and its layer's number."""

    points_mm: Points
    color: str
    layer: int


@dataclass(slots=True)
class Trace:
    """Everything a picture shows. `ink` in drawing order, `travels` polylines (n, 2), `layers` names by number in order."""

    ink: list[Line] = field(default_factory=list)
    travels: list[Points] = field(default_factory=list)
    layers: dict[int, str] = field(default_factory=dict)

    @property
    def down_mm(self) -> float:
        return sum(_length_mm(line.points_mm) for line in self.ink)

    @property
    def up_mm(self) -> float:
        return sum(_length_mm(points) for points in self.travels)


def flatten(motion: Motion, tolerance_mm: float) -> Points:
    """A polyline (n, 2), n >= 1, within `tolerance_mm` of the motion's path, with its exact ends.

    Inside a piece the acceleration is linear, so its norm is greatest at one end, and a chord over a time h is no further
    from the cubic than max|a| h^2 / 8. Half the tolerance goes to the chords, half to leaving points out again.
    """
    if not len(motion):
        return motion.end_mm[None, :].copy()
    _, _, last_acceleration = motion.ends()
    bend = np.maximum(np.hypot(*motion.acceleration_mm_s2.T), np.hypot(*last_acceleration.T))
    parts = np.maximum(1, np.ceil(motion.duration_s * np.sqrt(bend / (4 * tolerance_mm)))).astype(np.int64)
    piece = np.repeat(np.arange(len(parts)), parts)
    place = np.arange(len(piece)) - np.repeat(np.cumsum(parts) - parts, parts)
    # each piece from its own start: adding up the durations of a long motion first would cost digits, and time
    t = (place / parts[piece] * motion.duration_s[piece])[:, None]
    velocity = motion.velocity_mm_s[piece] + t * (motion.acceleration_mm_s2[piece] / 2 + t * motion.jerk_mm_s3[piece] / 6)
    points = np.vstack((motion.position_mm[piece] + t * velocity, motion.end_mm))
    return _thinned(points, tolerance_mm / 2)


def trace(
    actions: Iterable[Action],
    *,
    tolerance_mm: float,
    layer_colors: Mapping[int, str | None] | None = None,
    stroke_colors: Sequence[str | None] | None = None,
) -> Trace:
    """The pen's way through `actions`, in one pass; a stroke's own colour goes before its layer's, then the palette's."""
    seen = Trace()
    number = 0
    parts: list[Points] = []
    for action in actions:
        if isinstance(action, LayerStart):
            number = action.number
            seen.layers.setdefault(number, action.name)
        elif isinstance(action, Travel):
            points = flatten(action.motion, tolerance_mm)
            if len(points) > 1:
                seen.travels.append(points)
        elif isinstance(action, Draw):
            own = stroke_colors[action.stroke] if stroke_colors and 0 <= action.stroke < len(stroke_colors) else None
            color = own or (layer_colors or {}).get(number) or PALETTE[max(number - 1, 0) % len(PALETTE)]
            points = flatten(action.motion, tolerance_mm)
            parts.append(points[1:] if parts else points)
            if action.last:
                seen.ink.append(Line(np.concatenate(parts), visible(color), number))
                parts = []
    return seen


def thin_polyline(points_mm: Points, tolerance_mm: float) -> Points:
    """The polyline (n, 2) with the points left out that `tolerance_mm` allows; its ends stay."""
    return _thinned(np.asarray(points_mm, dtype=np.float64).reshape(-1, 2), tolerance_mm)


def visible(color: str) -> str:
    """The colour, or a grey where it could not be told from white paper."""
    red, green, blue = (int(color[i : i + 2], 16) for i in (1, 3, 5))
    return "#b0b0b0" if 0.2126 * red + 0.7152 * green + 0.0722 * blue > 235 else color


def _thinned(points: Points, tolerance_mm: float) -> Points:
    if len(points) < 3:
        return points
    return np.asarray(
        shapely.get_coordinates(shapely.simplify(shapely.linestrings(points), tolerance_mm, preserve_topology=False))
    )


def _length_mm(points: Points) -> float:
    return float(np.hypot(*np.diff(points, axis=0).T).sum())
