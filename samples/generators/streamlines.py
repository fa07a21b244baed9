"""Wind over a strait: evenly spaced streamlines of a smooth flow, in long polylines without a curve, as p5.js saves them."""

from __future__ import annotations

import numpy as np

from generators.svgtext import num

WIDTH_MM, HEIGHT_MM = 297.0, 210.0
MARGIN_MM = 12.0
SPACING_MM = 2.2
STEP_MM = 0.7
SHORTEST_STEPS = 14
SEED = 12
PX_PER_MM = 96 / 25.4

# vortices: x, y, reach, strength
VORTICES = (
    (80.0, 75.0, 34.0, 1.9),
    (190.0, 140.0, 40.0, -2.2),
    (235.0, 55.0, 24.0, 1.5),
    (60.0, 165.0, 26.0, -1.4),
    (140.0, 40.0, 18.0, -1.0),
)


def _direction(x: float, y: float) -> tuple[float, float]:
    """The flow's unit direction: a steady wind from the left that waves, and vortices that fade with distance."""
    u, v = 1.0, 0.35 * np.sin(x / 31.0 + y / 57.0)
    for cx, cy, reach, strength in VORTICES:
        dx, dy = (x - cx) / reach, (y - cy) / reach
        pull = strength * np.exp(-(dx * dx + dy * dy) / 2)
        u, v = u - pull * dy, v + pull * dx
    size = float(np.hypot(u, v)) or 1.0
    return float(u) / size, float(v) / size


class _Ground:
    """Which places are taken, by line, in cells no wider than the spacing."""

    def __init__(self) -> None:
        self._cells: dict[tuple[int, int], list[tuple[float, float]]] = {}

    def is_free(self, x: float, y: float, distance: float) -> bool:
        column, row = int(x / SPACING_MM), int(y / SPACING_MM)
        return not any(
            (x - px) ** 2 + (y - py) ** 2 < distance * distance
            for c in (column - 1, column, column + 1)
            for r in (row - 1, row, row + 1)
            for px, py in self._cells.get((c, r), ())
        )

    def take(self, line: list[tuple[float, float]]) -> None:
        for x, y in line:
            self._cells.setdefault((int(x / SPACING_MM), int(y / SPACING_MM)), []).append((x, y))


def _follow(x: float, y: float, sign: float, ground: _Ground) -> list[tuple[float, float]]:
    """Midpoint steps along the flow until the margin, another line, or this line's own tail is near."""
    line: list[tuple[float, float]] = []
    for _ in range(900):
        u, v = _direction(x, y)
        u, v = _direction(x + sign * u * STEP_MM / 2, y + sign * v * STEP_MM / 2)
        x, y = x + sign * u * STEP_MM, y + sign * v * STEP_MM
        inside = MARGIN_MM <= x <= WIDTH_MM - MARGIN_MM and MARGIN_MM <= y <= HEIGHT_MM - MARGIN_MM
        if not inside or not ground.is_free(x, y, SPACING_MM * 0.6):
            break
        if any((x - px) ** 2 + (y - py) ** 2 < (SPACING_MM * 0.6) ** 2 for px, py in line[:-6:2]):
            break
        line.append((x, y))
    return line


def streamlines() -> str:
    rng = np.random.default_rng(SEED)
    ground = _Ground()
    lines: list[list[tuple[float, float]]] = []
    seeds = rng.random((6000, 2)) * [WIDTH_MM - 2 * MARGIN_MM, HEIGHT_MM - 2 * MARGIN_MM] + MARGIN_MM
    for x, y in seeds.tolist():
        if not ground.is_free(x, y, SPACING_MM):
            continue
        line = [*_follow(x, y, -1.0, ground)[::-1], (x, y), *_follow(x, y, 1.0, ground)]
        if len(line) >= SHORTEST_STEPS:
            ground.take(line)
            lines.append(line)
    size = f"{num(WIDTH_MM * PX_PER_MM, 2)} {num(HEIGHT_MM * PX_PER_MM, 2)}"
    paths = "".join(
        '<path fill="none" stroke="rgb(24,78,119)" '
        'paint-order="fill stroke markers" stroke-opacity="1" stroke-miterlimit="10" d="'
        + " ".join(f"{'L' if i else 'M'} {num(x * PX_PER_MM, 2)} {num(y * PX_PER_MM, 2)}" for i, (x, y) in enumerate(line))
        + '"/>'
        for line in lines
    )
    return (
        f'<svg version="1.1" xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        f'width="{num(WIDTH_MM)}mm" height="{num(HEIGHT_MM)}mm" viewBox="0 0 {size}">'
        "<title>Streamlines</title><desc>Public domain, CC0 1.0</desc><defs/>"
        f'<g transform="scale(1,1)"><g><g transform="scale(1,1) translate(0,0)">{paths}</g></g></g></svg>\n'
    )
