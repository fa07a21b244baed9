"""A hatched city: boxes seen from a corner, a tone a side, every hatch cut where a nearer box hides it."""

from __future__ import annotations

import numpy as np

from generators.svgtext import Points, num

WIDTH_MM, HEIGHT_MM = 279.4, 215.9  # US letter, landscape
SEED = 64
BLOCKS = 11
UNIT_MM = 12.4
FOOT_MM = np.array([WIDTH_MM / 2, 72.0])  # where the farthest corner of the ground is on the page

RIGHT = np.array([np.cos(np.pi / 6), 0.5]) * UNIT_MM  # the ground's x axis on the page, towards the lower right
LEFT = np.array([-np.cos(np.pi / 6), 0.5]) * UNIT_MM  # its y axis, towards the lower left
UP = np.array([0.0, -1.0]) * UNIT_MM

Segment = tuple[Points, Points]


def _inside_span(a: Points, b: Points, polygon: Points) -> tuple[float, float] | None:
    """The part (t0, t1) of the segment a + t (b - a) inside a convex polygon that goes clockwise on the page."""
    t0, t1 = 0.0, 1.0
    direction = b - a
    for p, q in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        edge = q - p
        inwards = np.array([-edge[1], edge[0]])
        along, start = float(direction @ inwards), float((a - p) @ inwards)
        if abs(along) < 1e-12:
            if start <= 1e-9:
                return None
        elif along > 0:
            t0 = max(t0, -start / along)
        else:
            t1 = min(t1, -start / along)
        if t1 - t0 < 1e-6:
            return None
    return t0, t1


def _visible(a: Points, b: Points, hiding: list[Points]) -> list[Segment]:
    """What is left of the segment when the polygons in front are cut out of it."""
    spans = [(0.0, 1.0)]
    for polygon in hiding:
        if (
            max(a[0], b[0]) < polygon[:, 0].min()
            or min(a[0], b[0]) > polygon[:, 0].max()
            or max(a[1], b[1]) < polygon[:, 1].min()
            or min(a[1], b[1]) > polygon[:, 1].max()
        ):
            continue
        cut = _inside_span(a, b, polygon)
        if cut is None:
            continue
        spans = [
            part for lo, hi in spans for part in ((lo, min(hi, cut[0])), (max(lo, cut[1]), hi)) if part[1] - part[0] > 1e-6
        ]
    return [(a + lo * (b - a), a + hi * (b - a)) for lo, hi in spans if (hi - lo) * np.hypot(*(b - a)) > 0.3]


def _hatch(origin: Points, u: Points, v: Points, spacing_mm: float, inset: float = 0.0) -> list[Segment]:
    """Lines along u across the parallelogram origin, u, v, every other one drawn backwards."""
    count = max(1, int(np.hypot(*v) / spacing_mm))
    lines = []
    for k in range(1, count):
        start, end = origin + v * k / count + u * inset, origin + v * k / count + u * (1 - inset)
        lines.append((start, end) if k % 2 else (end, start))
    return lines


def _box(
    x: float, y: float, wide: float, deep: float, high: float, rng: np.random.Generator
) -> tuple[Points, dict[str, list[Segment]]]:
    """The outline of a box on the page, clockwise, and its lines by layer."""
    foot = FOOT_MM + (x + wide) * RIGHT + (y + deep) * LEFT  # the nearest corner, on the ground
    top = foot + high * UP
    left, right = -wide * RIGHT, -deep * LEFT  # from the nearest corner: along the left side, along the right side
    outline = np.array([foot, foot + left, top + left, top + left + right, top + right, foot + right])
    faces = [(foot, left), (foot, right)]
    lines: dict[str, list[Segment]] = {"edges": [], "hatching": []}
    corners = [foot, foot + left, top + left, top + left + right, top + right, foot + right]
    lines["edges"] += list(zip(corners, corners[1:] + corners[:1], strict=True))
    lines["edges"] += [(foot, top), (top, top + left), (top, top + right)]
    lines["hatching"] += _hatch(faces[0][0], high * UP, left, 0.75)  # left side: darkest, upright lines
    style = rng.integers(3)
    if style == 0:  # right side: level lines
        lines["hatching"] += _hatch(foot, right, high * UP, 1.7)
    else:  # or windows
        rows, columns = int(high * 1.6), max(2, int(deep * 2.2))
        for row in range(1, rows):
            for column in range(columns):
                if style == 2 and rng.random() < 0.3:
                    continue
                a = foot + right * (column + 0.25) / columns + high * UP * (row + 0.1) / rows
                across, rise = right * 0.5 / columns, high * UP * 0.55 / rows
                lines["edges"] += [
                    (a, a + across),
                    (a + across, a + across + rise),
                    (a + across + rise, a + rise),
                    (a + rise, a),
                ]
    if rng.random() < 0.4:  # a roof's inner edge
        mid = top + (left + right) / 2
        inner = [mid + (corner - mid) * 0.72 for corner in (top, top + left, top + left + right, top + right)]
        lines["edges"] += list(zip(inner, inner[1:] + inner[:1], strict=True))
    return outline, lines


def city() -> str:
    rng = np.random.default_rng(SEED)
    boxes = []
    for x in range(BLOCKS):
        for y in range(BLOCKS):
            if x % 4 == 3 or y % 4 == 3:
                continue  # streets
            centre = np.hypot(x - 3.0, y - 3.5) / BLOCKS
            high = (0.6 + 7.5 * np.exp(-((centre / 0.36) ** 2))) * rng.uniform(0.55, 1.2)
            if rng.random() < 0.06:
                high = 0.15
            boxes.append((x + y, _box(x + 0.08, y + 0.08, 0.84, 0.84, float(high), rng)))
    boxes.sort(key=lambda box: -box[0])  # the nearest first; those at the same distance never overlap
    hiding: list[Points] = []
    layers: dict[str, list[Segment]] = {"edges": [], "hatching": []}
    for _, (outline, lines) in boxes:
        for name, segments in lines.items():
            for a, b in segments:
                layers[name] += _visible(a, b, hiding)
        hiding.append(outline)
    colors = {"edges": "#1f1f1f", "hatching": "#3d6a8c"}
    body = ""
    for name, segments in layers.items():
        items = "\n".join(
            f'  <line x1="{num(a[0], 2)}" y1="{num(a[1], 2)}" x2="{num(b[0], 2)}" y2="{num(b[1], 2)}"/>' for a, b in segments
        )
        body += (
            f'<g id="{name}" fill="none" stroke="{colors[name]}" stroke-width="0.3" stroke-linecap="round">\n{items}\n</g>\n'
        )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH_MM}mm" height="{HEIGHT_MM}mm"'
        f' viewBox="0 0 {WIDTH_MM} {HEIGHT_MM}">\n'
        f"<title>Hatched city</title>\n<desc>Public domain, CC0 1.0</desc>\n{body}</svg>\n"
    )
