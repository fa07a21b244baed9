"""Pen-up distance, lifts and time of the order: the file's, greedy and best, against vpype and lower bounds.

Times are processor seconds of the ordering alone, so that a busy machine does not change them. vpype gets the same strokes in
the same run, as millimetres in place of its pixels. `best` has its default budget; `half` is best with a time budget that ends
it within half of vpype's two-opt, once as plots are ordered and once with lines that lie on each other kept, as vpype does.

vpype's two-opt takes ten minutes for 100,000 strokes: set PLOTTER_BENCH_FULL=1 to run it on those as well.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import shapely
import vpype
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial import Delaunay
from vpype_cli import execute

from planning.geometry.stroke import Layer, Stroke
from planning.motion.plan import plan_seconds
from planning.motion.planner import plan
from planning.ordering.arrange import OrderOptions, order_layers, travel
from planning.ordering.duplicates import draw_once
from planning.ordering.joining import join_strokes
from plotter.pipeline import motion_settings, prepare
from plotter.settings import resolve
from plotter.svg.options import ReadOptions
from plotter.svg.read import read_drawing

Array = NDArray[np.float64]

HOME = np.zeros(2)
TOLERANCE_MM = 0.1
SAMPLES = Path(__file__).parent.parent / "samples"
# Above this many strokes vpype's two-opt is left out unless asked for.
MOST_FOR_TWO_OPT = 20_000
FULL = os.environ.get("PLOTTER_BENCH_FULL") == "1"


def short_strokes(count: int) -> list[Stroke]:
    """Up to 3 mm long, anywhere on a square of 6 mm2 for each, in any direction."""
    rng = np.random.default_rng(1)
    start = rng.random((count, 2)) * np.sqrt(6.0 * count)
    angle, length = rng.random(count) * 2 * np.pi, rng.random(count) * 3
    end = start + np.stack((np.cos(angle), np.sin(angle)), axis=1) * length[:, None]
    return [Stroke(points) for points in np.stack((start, end), axis=1)]


def dots(count: int) -> list[Stroke]:
    """Uniformly random, on a square of 6 mm2 for each."""
    return [Stroke(point[None]) for point in np.random.default_rng(2).random((count, 2)) * np.sqrt(6.0 * count)]


def circles(count: int) -> list[Stroke]:
    """Radius 0.3 to 2.3 mm, anywhere; all start at their right."""
    rng = np.random.default_rng(3)
    angle = np.linspace(0, 2 * np.pi, 61)
    ring = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    ring[-1] = ring[0]
    centre, radius = rng.random((count, 2)) * np.sqrt(6.0 * count), 0.3 + 2 * rng.random(count)
    smooth = np.r_[True, np.zeros(59, dtype=bool), True]
    return [Stroke(c + r * ring, smooth) for c, r in zip(centre, radius, strict=True)]


def hatched_map(cells: int = 150) -> list[Stroke]:
    """Countries with their borders, and each hatched at its own angle and distance; neighbours' borders are drawn twice."""
    rng = np.random.default_rng(4)
    page = shapely.box(0, 0, 280, 200)
    sites = shapely.multipoints(rng.random((cells, 2)) * [280, 200])
    strokes = []
    for cell in shapely.get_parts(shapely.voronoi_polygons(sites, extend_to=page)):
        country = shapely.intersection(cell, page)
        strokes.append(Stroke(shapely.get_coordinates(country)))
        angle, apart = rng.random() * np.pi, 0.6 + 1.5 * rng.random()
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        offsets = np.arange(-400, 400, apart)[:, None, None]
        lines = shapely.linestrings(offsets * across + np.array([[-400.0], [400.0]]) * along)
        inside = shapely.get_parts(shapely.intersection(lines, shapely.buffer(country, -0.3)))
        strokes += [Stroke(shapely.get_coordinates(line)) for line in inside if shapely.length(line) > 0]
    return [strokes[k] for k in rng.permutation(len(strokes))]


def touching_edges(side: int = 100) -> list[Stroke]:
    """The edges of a square grid, each a stroke, in no order."""
    edges = [np.array([[i, j], [i + 1, j]], dtype=float) for i in range(side - 1) for j in range(side)]
    edges += [points[:, ::-1] for points in edges]
    return [Stroke(2 * edges[k]) for k in np.random.default_rng(5).permutation(len(edges))]


def samples() -> Iterator[tuple[str, list[Stroke]]]:
    """The drawings in samples/, all layers as one."""
    for path in sorted(SAMPLES.glob("*.svg")):
        yield path.stem, [stroke for layer in read_drawing(path).layers for stroke in layer.strokes]


@dataclass(frozen=True)
class Row:
    """One way of ordering one set. `travel_mm` is the pen-up distance from home on."""

    way: str
    travel_mm: float
    lifts: int
    seconds: float


def timed(way: str, work: Callable[[], Sequence[Stroke]]) -> Row:
    start = time.process_time()
    strokes = work()
    return Row(way, travel(strokes, HOME), len(strokes), time.process_time() - start)


def ours(strokes: Sequence[Stroke], order: str, budget_s: float = 10.0, *, keep: bool = False) -> list[Stroke]:
    """`keep`: lines that lie on each other are not looked for, as vpype does not."""
    layer = Layer(1, "all", tuple(Stroke(s.points_mm, s.corners) for s in strokes))
    options = OrderOptions(order, budget_s, TOLERANCE_MM, keep_duplicates=keep)  # type: ignore[arg-type]
    return list(order_layers([layer], options, HOME)[0].strokes)


def _within_half(way: str, strokes: Sequence[Stroke], half_s: float, keep: bool) -> Row:
    """`best` with a budget that should end it within `half_s`: what greedy leaves of it, less a reserve.

    The budget is nominal work; when the first guess leaves time, a second one uses it, and counts if it ends in time. Where
    even the least does not, it is greedy.
    """
    greedy = timed("greedy", lambda: ours(strokes, "greedy", keep=keep))
    budget_s = max(1e-6, 0.6 * (half_s - greedy.seconds))
    row = timed(way, lambda: ours(strokes, "best", budget_s, keep=keep))
    if row.seconds < 0.9 * half_s:
        budget_s *= min(4.0, (0.95 * half_s - greedy.seconds) / max(row.seconds - greedy.seconds, 1e-4))
        longer = timed(way, lambda: ours(strokes, "best", budget_s, keep=keep))
        row = longer if longer.seconds <= half_s and longer.travel_mm < row.travel_mm else row
    return replace(greedy, way=way) if row.seconds > half_s else row


def with_vpype(strokes: Sequence[Stroke], command: str) -> Row:
    """What vpype makes of the same strokes, timed without the conversions."""
    # vpype drops lines of one point: a dot is given a second one where it stands.
    lines = [(s.points_mm if len(s.points_mm) > 1 else s.points_mm.repeat(2, axis=0)) @ [1, 1j] for s in strokes]
    document = vpype.Document()
    document.add(vpype.LineCollection(lines), 1)
    start = time.process_time()
    document = execute(command, document)
    seconds = time.process_time() - start
    found = [Stroke(np.stack((line.real, line.imag), axis=1)) for line in document.layers[1].lines]
    return Row("vpype " + command.replace(f" --tolerance {TOLERANCE_MM}", ""), travel(found, HOME), len(found), seconds)


def spanning_bound_mm(strokes: Sequence[Stroke]) -> float:
    """Least pen-up distance there can be: the links of a route connect all strokes, as those of a spanning tree do.

    The strokes themselves cost nothing. A shortest tree needs only the edges of the Delaunay triangulation.
    """
    sizes = [len(s.points_mm) if s.is_closed else min(2, len(s.points_mm)) for s in strokes]
    nodes = np.concatenate(
        [HOME[None]] + [s.points_mm if s.is_closed else s.points_mm[[0, -1]][:k] for s, k in zip(strokes, sizes, strict=True)]
    )
    owner = np.concatenate(([0], np.repeat(np.arange(1, len(strokes) + 1), sizes)))
    points, where = np.unique(nodes, axis=0, return_inverse=True)
    where = where.ravel()
    if len(points) < 4:
        return 0.0
    corners = Delaunay(points).simplices
    u, v = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]).T
    first = np.full(len(strokes) + 1, -1)
    first[owner[::-1]] = where[::-1]
    a, b = np.concatenate((u, first[owner])), np.concatenate((v, where))
    cost = np.concatenate((np.hypot(*(points[u] - points[v]).T) + 1e-9, np.full(len(where), 1e-12)))
    low, high = np.minimum(a, b), np.maximum(a, b)
    order = np.lexsort((cost, high, low))
    low, high, cost = low[order], high[order], cost[order]
    new = np.append(True, (np.diff(low) != 0) | (np.diff(high) != 0)) & (low != high)
    graph = coo_array((cost[new], (low[new], high[new])), shape=(len(points), len(points)))
    return float(minimum_spanning_tree(graph.tocsr()).sum()) * (1 - 1e-9)


def measure(name: str, strokes: list[Stroke], known_mm: float | None = None) -> None:
    """Print the table of one set."""
    joined = join_strokes(draw_once([Stroke(s.points_mm) for s in strokes]), TOLERANCE_MM)
    bound = spanning_bound_mm(joined)
    merge = f"linemerge --tolerance {TOLERANCE_MM}"
    rows = [timed("file", lambda: strokes), timed("greedy", lambda: ours(strokes, "greedy"))]
    rows += [with_vpype(strokes, merge + " linesort")]
    two_opt = None
    if FULL or len(strokes) <= MOST_FOR_TWO_OPT:
        two_opt = with_vpype(strokes, merge + " linesort --two-opt")
        rows.append(two_opt)
        for way, keep in (("half", False), ("half, duplicates kept", True)):
            rows.append(_within_half(way, strokes, two_opt.seconds / 2, keep))
    rows.append(timed("best", lambda: ours(strokes, "best")))
    print(
        f"\n{name}: {len(strokes)} strokes, {sum(len(s.points_mm) for s in strokes)} points; no tour is below {bound:.0f} mm",
        end="",
    )
    print(f"; best known {known_mm:.0f} mm" if known_mm else "")
    print(f"  {'':34}{'pen up mm':>12}{'lifts':>8}{'s':>9}{'/ bound':>9}{'/ two-opt':>11}{'/ its s':>9}{'/ known':>9}")
    for row in rows:
        over = row.travel_mm / bound if bound > 1e-3 else np.nan
        print(
            f"  {row.way:34}{row.travel_mm:12.0f}{row.lifts:8}{row.seconds:9.2f}{over:9.3f}",
            end="",
        )
        print(
            f"{row.travel_mm / max(two_opt.travel_mm, 1e-9):11.3f}{row.seconds / two_opt.seconds:9.2f}"
            if two_opt
            else " " * 20,
            end="",
        )
        print(f"{row.travel_mm / known_mm:9.3f}" if known_mm else "", flush=True)


def plot_times() -> None:
    """What overlap and low lifts save of each sample's plan, at the default limits: one order, three plans."""
    print(f"\nplot time{'':14}{'lifts':>8}{'waiting s':>12}{'overlap s':>12}{'and low s':>12}{'saved':>9}")
    totals = np.zeros(3)
    for path in sorted(SAMPLES.glob("*.svg")):
        defaults = resolve({}, Path(os.devnull)).values
        job = prepare(str(path), ReadOptions(), defaults)
        seconds = []
        for changed in ({"overlap": 0.0, "low_lift": 0.0}, {"low_lift": 0.0}, {}):
            limits = motion_settings(defaults.model_copy(update=changed), job.machine)
            seconds.append(sum(map(plan_seconds, plan(job.layers, limits, job.start_mm, defaults.end_mm()))))
        totals += seconds
        saved = 100 * (1 - seconds[2] / seconds[0])
        print(f"  {path.stem:21}{job.stroke_count:8}" + "".join(f"{s:12.1f}" for s in seconds) + f"{saved:8.1f}%", flush=True)
    print(f"  {'all':21}{'':8}" + "".join(f"{s:12.1f}" for s in totals) + f"{100 * (1 - totals[2] / totals[0]):8.1f}%")


def run() -> None:
    """Plot times, all generated sets, then the samples."""
    plot_times()
    # The best tour of 10,000 random points is 0.7168 sqrt(n A) long (Johnson and McGeoch, 1997).
    measure("random dots", dots(10_000), known_mm=0.7168 * np.sqrt(10_000 * 60_000))
    measure("random short strokes", short_strokes(10_000))
    measure("circles", circles(10_000))
    measure("hatched map", hatched_map())
    measure("grid of touching edges", touching_edges())
    for name, strokes in samples():
        measure(name + ".svg", strokes)
    measure("random short strokes", short_strokes(100_000))
