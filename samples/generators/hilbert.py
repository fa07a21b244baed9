"""A Hilbert curve that is finer where its picture is darker: one stroke of right angles and slants, no curve in it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from generators.svgtext import num

WIDTH_MM, HEIGHT_MM = 200.0, 200.0
SIDE_MM = 184.0
COARSEST, FINEST = 5, 8


def _darkness(x: float, y: float) -> float:
    """The picture, 0 white to 1 black, on the unit square: a lit ball on a floor, with its shadow."""
    bx, by, radius = 0.5, 0.45, 0.3
    dx, dy = (x - bx) / radius, (y - by) / radius
    inside = dx * dx + dy * dy
    if inside < 1.0:
        dz = float(np.sqrt(1.0 - inside))
        light = max(0.0, -0.5 * dx - 0.5 * dy + 0.7 * dz)
        rim = 0.5 * (1.0 - dz) ** 3
        return min(1.0, max(0.3, 1.15 - 0.95 * light - rim))
    shadow = ((x - 0.64) / 0.33) ** 2 + ((y - 0.775) / 0.085) ** 2
    return 0.9 * float(np.exp(-(shadow**2) * 0.7))


def _visit(
    x: float, y: float, side: float, a: tuple[int, int], b: tuple[int, int], level: int, out: list[tuple[float, float]]
) -> None:
    """Appends the centres of the cells of the square at corner (x, y) in Hilbert's order.

    `a` and `b` are the square's axes as unit vectors: the curve enters at the corner and leaves at the far end of `a`.
    A cell is divided until it is as fine as the picture is dark there.
    """
    cx, cy = x + side / 2 * (a[0] + b[0]), y + side / 2 * (a[1] + b[1])
    wanted = COARSEST + (FINEST + 0.99 - COARSEST) * _darkness(cx, cy)
    if level >= COARSEST and level >= int(wanted):
        out.append((cx, cy))
        return
    half = side / 2
    back_a, back_b = (-a[0], -a[1]), (-b[0], -b[1])
    _visit(x, y, half, b, a, level + 1, out)
    _visit(x + half * b[0], y + half * b[1], half, a, b, level + 1, out)
    _visit(x + half * (a[0] + b[0]), y + half * (a[1] + b[1]), half, a, b, level + 1, out)
    far_x, far_y = x + side * a[0] + half * b[0], y + side * a[1] + half * b[1]
    _visit(far_x, far_y, half, back_b, back_a, level + 1, out)


def hilbert() -> str:
    cells: list[tuple[float, float]] = []
    _visit(0.0, 0.0, 1.0, (1, 0), (0, 1), 0, cells)
    points = np.array(cells) * SIDE_MM + np.array([(WIDTH_MM - SIDE_MM) / 2, (HEIGHT_MM - SIDE_MM) / 2])
    moves = [f"M{num(points[0, 0])} {num(points[0, 1])}"]
    for (x0, y0), (x1, y1) in pairwise(points.tolist()):
        if y0 == y1:
            moves.append(f"H{num(x1)}")
        elif x0 == x1:
            moves.append(f"V{num(y1)}")
        else:
            moves.append(f"L{num(x1)} {num(y1)}")
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{num(WIDTH_MM)}mm" height="{num(HEIGHT_MM)}mm" '
        f'viewBox="0 0 {num(WIDTH_MM)} {num(HEIGHT_MM)}">\n'
        "<title>A ball, in one Hilbert curve</title>\n<desc>Public domain, CC0 1.0</desc>\n"
        f'<path fill="none" stroke="#222" stroke-width=".35" stroke-linejoin="round" d="{"".join(moves)}"/>\n</svg>\n'
    )
