"""A moon in small circles, packed by weighted Voronoi relaxation (Secord 2002): thousands of strokes of a millimetre or two."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generators.svgtext import Points, num

WIDTH_MM, HEIGHT_MM = 210.0, 210.0
CENTER_MM, RADIUS_MM = 105.0, 92.0
CELL_MM = 0.2
DOTS = 7000
ROUNDS = 16
SEED = 1969
LIGHT = np.array([-0.72, -0.42, 0.55])

Grid = NDArray[np.float64]


def darkness() -> Grid:
    """The moon's tone on a grid of CELL_MM, 0 white to 1 black: a ball, its craters' rims, dark plains; white around it."""
    rng = np.random.default_rng(SEED)
    side = int(WIDTH_MM / CELL_MM)
    y, x = (np.mgrid[0:side, 0:side] + 0.5) * CELL_MM
    x, y = (x - CENTER_MM) / RADIUS_MM, (y - CENTER_MM) / RADIUS_MM
    disc = x * x + y * y < 1
    z = np.sqrt(np.where(disc, 1 - x * x - y * y, 0))
    normal = np.stack((x, y, z))
    plains = np.zeros_like(x)
    for _ in range(16):
        px, py, size = rng.uniform(-0.55, 0.45), rng.uniform(-0.7, 0.5), rng.uniform(0.1, 0.26)
        plains += 0.5 * np.exp(-((((x - px) ** 2 + (y - py) ** 2) / size**2) ** 2))
    for _ in range(150):
        at = rng.normal(size=3)
        at /= np.linalg.norm(at)
        at[2] = abs(at[2])
        size = 0.028 + 0.16 * rng.random() ** 5
        away = np.clip(1 - np.tensordot(at, normal, axes=(0, 0)), 0, None)
        d = np.sqrt(2 * away) / size  # distance over the surface, in crater radii
        # a bowl with a raised rim: the slope along d leans the surface outwards inside the rim and away outside it
        slope = 1.25 * d * np.exp(-((d - 0.75) ** 2) / 0.06) - 0.75 * np.exp(-((d - 1.2) ** 2) / 0.04)
        outwards = normal - at[:, None, None]
        normal = normal - slope * outwards / np.maximum(np.linalg.norm(outwards, axis=0), 1e-9)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=0), 1e-9)
    light = np.clip(np.tensordot(LIGHT / np.linalg.norm(LIGHT), normal, axes=(0, 0)), 0, 1)
    tone = 1.0 - 0.93 * light**0.8 + 0.3 * np.clip(plains, 0, 1) * light
    return np.where(disc, np.clip(tone, 0.0, 1.0) ** 1.7 * 0.93 + 0.035, 0.0)


def _owners(dots: Points, side: int) -> NDArray[np.int64]:
    """For every cell of the grid the nearest dot, by jump flooding: each pass asks neighbours half as far away."""
    owner = np.full((side, side), -1, dtype=np.int64)
    cell = np.clip(dots / CELL_MM, 0, side - 1).astype(np.int64)
    owner[cell[:, 1], cell[:, 0]] = np.arange(len(dots))
    y, x = ((np.mgrid[0:side, 0:side] + 0.5) * CELL_MM).astype(np.float32)
    px, py = dots.astype(np.float32).T
    best = np.full((side, side), np.inf, dtype=np.float32)
    taken = owner >= 0
    best[taken] = (x[taken] - px[owner[taken]]) ** 2 + (y[taken] - py[owner[taken]]) ** 2
    for jump in (128, 64, 32, 16, 8, 4, 2, 1):
        for dy in (-jump, 0, jump):
            for dx in (-jump, 0, jump):
                if dx == 0 and dy == 0:
                    continue
                here = (slice(max(0, -dy), side - max(0, dy)), slice(max(0, -dx), side - max(0, dx)))
                there = (slice(max(0, dy), side - max(0, -dy)), slice(max(0, dx), side - max(0, -dx)))
                asked = owner[there]
                distance = (x[here] - px[asked]) ** 2 + (y[here] - py[asked]) ** 2
                nearer = (asked >= 0) & (distance < best[here])
                owner[here][nearer] = asked[nearer]
                best[here][nearer] = distance[nearer]
    return owner


def stipple() -> str:
    tone = darkness()
    side = len(tone)
    rng = np.random.default_rng(SEED + 1)
    weight = tone.ravel() / tone.sum()
    chosen = np.searchsorted(np.cumsum(weight), rng.random(DOTS))
    dots = (np.column_stack((chosen % side, chosen // side)) + rng.random((DOTS, 2))) * CELL_MM
    y, x = (np.mgrid[0:side, 0:side] + 0.5) * CELL_MM
    for _ in range(ROUNDS):
        owner = _owners(dots, side).ravel()
        mass = np.bincount(owner, tone.ravel(), DOTS)
        moments = [np.bincount(owner, (tone * axis).ravel(), DOTS) for axis in (x, y)]
        held = mass > 0
        dots[held] = (np.column_stack(moments)[held].T / mass[held]).T
    column, row = np.clip(dots / CELL_MM, 0, side - 1).astype(int).T
    radius = 0.2 + 0.22 * tone[row, column]
    order = np.lexsort((dots[:, 0] * np.where((dots[:, 1] // 3).astype(int) % 2, -1, 1), dots[:, 1] // 3))
    circles = "\n".join(f'<circle cx="{num(dots[i, 0], 2)}" cy="{num(dots[i, 1], 2)}" r="{num(radius[i], 2)}"/>' for i in order)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{num(WIDTH_MM)}mm" height="{num(HEIGHT_MM)}mm" '
        f'viewBox="0 0 {num(WIDTH_MM)} {num(HEIGHT_MM)}">\n<title>Moon, stippled</title>\n<desc>Public domain, CC0 1.0</desc>\n'
        f'<g style="fill: none; stroke: black; stroke-width: 0.3">\n{circles}\n</g>\n</svg>\n'
    )
