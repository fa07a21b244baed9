"""A contour map of an invented coast: a synthetic height field cut at even heights by marching squares.

Written as vpype writes: a length in cm, a viewBox in CSS pixels, one layer group per pen, every line a <polyline>.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generators.svgtext import Points, num

WIDTH_CM, HEIGHT_CM = 29.7, 21.0
PX_PER_MM = 96 / 25.4
MARGIN_MM = 12.0
CELL_MM = 0.5
SEED = 1871
COLORS = {1: "#1d5f8a", 2: "#5b4a32", 3: "#a0361e"}  # water, land, every fifth height
NAMES = {1: "sea", 2: "land", 3: "index contours"}

Grid = NDArray[np.float64]

# Corners of a cell: 1 top left, 2 top right, 4 bottom right, 8 bottom left. Edges: 0 top, 1 right, 2 bottom, 3 left.
# Segments by case; the two saddles (5 and 10) are settled by the cell's mean height.
SEGMENTS = {
    1: ((3, 0),),
    2: ((0, 1),), 3: ((3, 1),), 4: ((1, 2),), 6: ((0, 2),), 7: ((3, 2),), 8: ((2, 3),), 9: ((2, 0),), 11: ((2, 1),),
    12: ((1, 3),), 13: ((1, 0),), 14: ((0, 3),),
}  # fmt: skip
SADDLES = {5: (((3, 2), (1, 0)), ((3, 0), (1, 2))), 10: (((0, 3), (2, 1)), ((0, 1), (2, 3)))}  # (mean above, mean below)


def _noise(shape: tuple[int, int], wavelength: float, rng: np.random.Generator) -> Grid:
    """Smooth noise in -1..1: random values on a coarse lattice, blended by the quintic that has no kink at lattice lines."""
    rows, cols = shape
    y, x = np.arange(rows)[:, None] / wavelength, np.arange(cols)[None, :] / wavelength
    lattice = rng.random((int(rows / wavelength) + 2, int(cols / wavelength) + 2)) * 2 - 1
    iy, ix = y.astype(int), x.astype(int)
    fy, fx = y - iy, x - ix
    wy, wx = (f * f * f * (f * (f * 6 - 15) + 10) for f in (fy, fx))
    top = lattice[iy, ix] * (1 - wx) + lattice[iy, ix + 1] * wx
    bottom = lattice[iy + 1, ix] * (1 - wx) + lattice[iy + 1, ix + 1] * wx
    return np.asarray(top * (1 - wy) + bottom * wy)


def height_field() -> Grid:
    """Heights in about -1..1 with the sea at 0; a ridge crosses the map and the noise gets finer and weaker by octaves."""
    rng = np.random.default_rng(SEED)
    rows, cols = (int((cm * 10 - 2 * MARGIN_MM) / CELL_MM) + 1 for cm in (HEIGHT_CM, WIDTH_CM))
    field = sum(0.5**octave * _noise((rows, cols), 165 / 1.9**octave, rng) for octave in range(5))
    y, x = np.mgrid[0:rows, 0:cols]
    ridge = np.exp(-(((y / rows - 0.62 + 0.35 * (x / cols - 0.5)) / 0.22) ** 2))
    bay = np.exp(-(((x / cols - 0.12) / 0.22) ** 2) - ((y / rows - 0.15) / 0.4) ** 2)
    return np.asarray(0.72 * field + 1.05 * ridge - 0.75 * bay - 0.25)


def _segments(field: Grid, level: float) -> tuple[Points, NDArray[np.int64]]:
    """Where `level` crosses the grid's edges: points by edge number (x, y in cells), and pairs (m, 2) of edge numbers."""
    rows, cols = field.shape
    above = field > level
    case = above[:-1, :-1] * 1 + above[:-1, 1:] * 2 + above[1:, 1:] * 4 + above[1:, :-1] * 8
    cell_row, cell_col = np.indices(case.shape)
    horizontal = rows * cols  # edge numbers: cell (r, c) has top r*cols+c; its left edge the same plus rows*cols
    edge = np.stack(
        (
            cell_row * cols + cell_col,
            horizontal + cell_row * cols + cell_col + 1,
            (cell_row + 1) * cols + cell_col,
            horizontal + cell_row * cols + cell_col,
        )
    )
    pairs: list[NDArray[np.int64]] = []
    for number, segments in SEGMENTS.items():
        at = case == number
        pairs += [np.column_stack((edge[a][at], edge[b][at])) for a, b in segments]
    mean_above = (field[:-1, :-1] + field[:-1, 1:] + field[1:, 1:] + field[1:, :-1]) / 4 > level
    for number, (if_above, if_below) in SADDLES.items():
        for segments, where in ((if_above, mean_above), (if_below, ~mean_above)):
            at = (case == number) & where
            pairs += [np.column_stack((edge[a][at], edge[b][at])) for a, b in segments]

    with np.errstate(divide="ignore", invalid="ignore"):
        along_x = (level - field[:, :-1]) / (field[:, 1:] - field[:, :-1])
        along_y = (level - field[:-1]) / (field[1:] - field[:-1])
    points = np.full((2 * rows * cols, 2), np.nan)
    r, c = np.indices(along_x.shape)
    points[(r * cols + c).ravel()] = np.column_stack(((c + along_x).ravel(), r.ravel()))
    r, c = np.indices(along_y.shape)
    points[(horizontal + r * cols + c).ravel()] = np.column_stack((c.ravel(), (r + along_y).ravel()))
    return points, np.vstack(pairs)


def _join(pairs: NDArray[np.int64]) -> list[list[int]]:
    """Chains of edge numbers; an edge has one or two segments, so every chain is a line or a ring (first number again)."""
    neighbours: dict[int, list[int]] = {}
    for a, b in pairs.tolist():
        neighbours.setdefault(a, []).append(b)
        neighbours.setdefault(b, []).append(a)
    chains = []
    ends = [node for node, near in neighbours.items() if len(near) == 1]
    for start in ends + list(neighbours):
        if start not in neighbours:
            continue
        chain, here = [start], start
        while neighbours.get(here):
            there = neighbours[here].pop()
            neighbours[there].remove(here)
            if not neighbours[here]:
                del neighbours[here]
            chain.append(there)
            here = there
        neighbours.pop(here, None)
        chains.append(chain)
    return chains


def contours() -> str:
    field = height_field()
    lines: dict[int, list[str]] = {1: [], 2: [], 3: []}
    for step in range(-40, 40):
        points, pairs = _segments(field, step * 0.045 + 1e-6)
        layer = 3 if step > 0 and step % 5 == 0 else 1 if step < 0 else 2
        for chain in _join(pairs):
            if len(chain) < 12:
                continue
            page_px = (points[chain] * CELL_MM + MARGIN_MM) * PX_PER_MM
            lines[layer].append(" ".join(f"{num(x, 2)},{num(y, 2)}" for x, y in page_px))
    width_px, height_px = (cm * 10 * PX_PER_MM for cm in (WIDTH_CM, HEIGHT_CM))
    groups = "".join(
        f'<g fill="none" id="layer{number}" inkscape:groupmode="layer" inkscape:label="{number} {NAMES[number]}" '
        f'stroke="{COLORS[number]}" stroke-width="{0.6 if number < 3 else 0.9}" style="display:inline">'
        + "".join(f'<polyline points="{points}"/>\n' for points in layer)
        + "</g>\n"
        for number, layer in lines.items()
    )
    return (
        '<?xml version="1.0" encoding="utf-8" ?>\n'
        f'<svg baseProfile="tiny" height="{num(HEIGHT_CM)}cm" version="1.2" '
        f'viewBox="0 0 {num(width_px, 5)} {num(height_px, 5)}" width="{num(WIDTH_CM)}cm" '
        'xmlns="http://www.w3.org/2000/svg" xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape">\n'
        f"<title>Contour map of an invented coast</title>\n<desc>Public domain, CC0 1.0</desc>\n<defs/>\n{groups}</svg>\n"
    )
