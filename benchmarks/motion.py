"""Motion planning measured: time against a bound and three other planners, deviation, peaks, pieces, CPU.

References, all on the same strokes, limits and tolerance:
- bound: fastest path following with |a| bounded (tangential and centripetal together) and infinite jerk, on the path as far as
  the tolerance can tell (thinned to half of it): curvature caps where that is smooth, junction-deviation speed of the tolerance
  where it has corners. A reference more than a strict bound: the tube allows cutting bends.
- trapezoid: straight moves with speed changes bounded by A, junction-deviation speed at every vertex (what saxi and axi do).
- stops: jerk-limited along the path, v = 0 at every sharp vertex.
- ruckig: jerk-limited along the path, junction speed at sharp vertices, ruckig between critical points (a = 0 there).
The last two bound jerk along the path only: across it, at every bend, theirs is unbounded.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from ruckig import InputParameter, Ruckig, RuckigError, Trajectory
from scipy.spatial import cKDTree

from planning.geometry.stroke import Layer, Stroke
from planning.motion import draw, speed
from planning.motion.limits import Kinematics, Limits
from planning.motion.path import PathSet, path_set, thinned
from planning.motion.plan import Draw, Motion, Travel
from planning.motion.planner import MotionSettings, PenTiming, plan

Points = NDArray[np.float64]

LIMIT_SETS = {
    "L1": Limits(100, 1000, 50e3, 0.05),
    "L2": Limits(150, 2000, 100e3, 0.05),
    "L2t": Limits(150, 2000, 100e3, 0.02),
    "L3": Limits(250, 5000, 500e3, 0.05),
    "L4": Limits(50, 500, 10e3, 0.02),
    "L5": Limits(150, 2000, 400e3, 0.03),
}
# AxiDraw: 80 steps/mm along each axis, CoreXY. A step rate that binds in no set, so that all planners have the same limits.
KINEMATICS = Kinematics(np.array([[80.0, 80.0], [80.0, -80.0]]), 40000.0)
TRAVEL = Limits(350, 4000, 250e3)
PAGE = ((-500.0, -500.0), (1000.0, 1000.0))


# --- strokes -----------------------------------------------------------------------------------------------------------


def circle(radius_mm: float, turns: float = 1.0, chord_mm: float = 0.01) -> Points:
    count = max(12, math.ceil(turns * 2 * math.pi / math.sqrt(8 * chord_mm / radius_mm)))
    t = np.linspace(0.0, turns * 2 * math.pi, count + 1)
    return np.stack((radius_mm * np.cos(t), radius_mm * np.sin(t)), axis=-1)


def bezier(points: list[tuple[float, float]], chord_mm: float = 0.01) -> Points:
    """A chain of cubic Beziers, flattened."""
    p = np.array(points, dtype=np.float64)
    out = [p[:1]]
    for k in range(0, len(p) - 1, 3):
        a, b, c, d = p[k : k + 4]
        bend = max(np.hypot(*(a - 2 * b + c)), np.hypot(*(b - 2 * c + d)))
        n = max(1, math.ceil(math.sqrt(6 * bend / (8 * chord_mm))))
        t = np.linspace(0, 1, n + 1)[1:, None]
        out.append(a * (1 - t) ** 3 + 3 * b * t * (1 - t) ** 2 + 3 * c * t * t * (1 - t) + d * t**3)
    return np.concatenate(out)


def polygon(*points: tuple[float, float]) -> Points:
    return np.array([*points, points[0]], dtype=np.float64)


def star(radius_mm: float) -> Points:
    t = np.arange(6) * 4 * math.pi / 5
    return np.stack((radius_mm * np.sin(t), radius_mm * np.cos(t)), axis=-1)


def hatch_rect(lines: int = 25, width_mm: float = 40.0, step_mm: float = 0.8) -> Points:
    return np.array([[(k // 2 % 2 != k % 2) * width_mm, k // 2 * step_mm] for k in range(2 * lines)], dtype=np.float64)


def zigzag(count: int, dx_mm: float, dy_mm: float) -> Points:
    k = np.arange(count)
    return np.stack((k * dx_mm, (k % 2) * dy_mm), axis=-1)


def hilbert(order: int, step_mm: float) -> Points:
    p = np.zeros((1, 2))
    for k in range(order):
        m = 2**k
        last = np.stack((2 * m - 1 - p[:, 1], m - 1 - p[:, 0]), axis=-1)
        p = np.concatenate((p[:, ::-1], p + np.array([0, m]), p + np.array([m, m]), last))
    return p * step_mm


def gosper(order: int, step_mm: float) -> Points:
    word = "A"
    for _ in range(order):
        word = "".join({"A": "A-B--B+A++AA+B-", "B": "+A-BB--B-A++A+B"}.get(c, c) for c in word)
    angle, at, out = 0.0, np.zeros(2), [np.zeros(2)]
    for c in word:
        if c in "AB":
            at = at + step_mm * np.array([math.cos(angle), math.sin(angle)])
            out.append(at)
        else:
            angle += math.radians(60 if c == "+" else -60)
    return np.array(out)


def spiral(turns: float, gap_mm: float, vertices: int) -> Points:
    t = np.linspace(0.0, turns * 2 * math.pi, vertices)
    r = gap_mm * t / (2 * math.pi)
    return np.stack((r * np.cos(t), r * np.sin(t)), axis=-1)


def cursive(size_mm: float, seed: int = 1, letters: int = 12) -> Points:
    """Loops and arches of changing size and slant, like joined handwriting."""
    rng = np.random.default_rng(seed)
    n = letters * 40
    t = np.linspace(0, letters * 2 * math.pi, n)
    height = np.interp(t, np.linspace(0, t[-1], letters), rng.uniform(0.5, 2.0, letters))
    loop = np.interp(t, np.linspace(0, t[-1], letters), rng.uniform(0.2, 1.1, letters))
    y = size_mm * height * (1 - np.cos(t)) / 2
    return np.stack((size_mm * (0.16 * t + 0.5 * loop * np.sin(t + 0.5)) + 0.3 * y, y), axis=-1)


def scribble(count: int, seed: int = 2) -> Points:
    rng = np.random.default_rng(seed)
    knots = rng.uniform(0, 30, (count, 2))
    t = np.arange(count)
    fine = np.linspace(0, count - 1, count * 25)
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(t, knots)(fine))


def noisy(length_mm: float, sigma_mm: float, seed: int = 3) -> Points:
    rng = np.random.default_rng(seed)
    x = np.arange(0, length_mm, 0.1)
    return np.stack((x, 10 * np.sin(x / 8) + rng.normal(0, sigma_mm, len(x))), axis=-1)


def walk(count: int, step_mm: float, seed: int = 4) -> Points:
    return np.cumsum(np.random.default_rng(seed).normal(0, step_mm, (count, 2)), axis=0)


def coast(order: int, size_mm: float, seed: int = 5, roughness: float = 0.18) -> Points:
    """Midpoint displacement, as coasts and borders look."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 2 * math.pi, 7)
    p = size_mm * np.stack((np.cos(t), np.sin(t)), axis=-1)
    for _ in range(order):
        a, b = p[:-1], p[1:]
        side = np.stack((b[:, 1] - a[:, 1], a[:, 0] - b[:, 0]), axis=-1)
        mid = (a + b) / 2 + side * rng.normal(0, roughness, (len(a), 1))
        p = np.concatenate((np.stack((a, mid), axis=1).reshape(-1, 2), p[-1:]))
    return p


def letters(size_mm: float) -> list[Points]:
    """Outlines in the manner of a text face: stems, bowls, counters."""
    k = 0.5523

    def curve(*points: tuple[float, float]) -> Points:
        return bezier(list(points), 0.01 / size_mm)

    def oval(x: float, y: float, rx: float, ry: float) -> Points:
        kx, ky = k * rx, k * ry
        upper = [(x + rx, y), (x + rx, y + ky), (x + kx, y + ry), (x, y + ry), (x - kx, y + ry), (x - rx, y + ky)]
        lower = [(x - rx, y), (x - rx, y - ky), (x - kx, y - ry), (x, y - ry), (x + kx, y - ry), (x + rx, y - ky)]
        return curve(*upper, *lower, (x + rx, y))

    def arch(x: float) -> Points:
        arm = curve((x + 0.1, 0.4), (x + 0.15, 0.52), (x + 0.4, 0.56), (x + 0.4, 0.3))
        back = curve((x + 0.32, 0.3), (x + 0.32, 0.46), (x + 0.14, 0.46), (x + 0.1, 0.3))
        head = np.array([(x, 0.0), (x, 0.5), (x + 0.1, 0.5)])
        foot = np.array([(x + 0.4, 0.0), (x + 0.32, 0.0)])
        return np.concatenate((head, arm, foot, back, np.array([(x + 0.1, 0.0), (x, 0.0)])))

    stem = polygon((1.72, 0), (1.82, 0), (1.82, 0.8), (1.72, 0.8))
    tent = polygon((2.0, 0), (2.3, 0.8), (2.4, 0.8), (2.7, 0), (2.6, 0), (2.5, 0.25), (2.2, 0.25), (2.1, 0))
    hole = polygon((2.24, 0.33), (2.46, 0.33), (2.35, 0.63))
    left, right = [(3.4, 0.8), (3.4, 0), (3.5, 0), (3.5, 0.35)], [(3.8, 0.35), (3.8, 0), (3.9, 0), (3.9, 0.8)]
    ladder = polygon(*left, *right, (3.8, 0.8), (3.8, 0.45), (3.5, 0.45), (3.5, 0.8))
    out = [oval(0.3, 0.25, 0.28, 0.26), oval(0.3, 0.25, 0.18, 0.17), arch(0.7), oval(1.5, 0.25, 0.26, 0.26),
           oval(1.5, 0.25, 0.17, 0.17), stem, tent, hole, arch(2.8), ladder]  # fmt: skip
    return [p * size_mm for p in out]


# The kinds of stroke on which the method's figures were first measured; the others came later and are harder.
REFERENCE = {
    "square20", "square2", "star30", "hatch_rect", "hatch_zig", "zigzag3", "circle0.5", "circle2.5", "circle10", "ellipse",
    "spiral", "cursive", "cursive_small", "hilbert5", "scribble", "noisy", "random_walk", "text4", "text15",
}  # fmt: skip


def strokes() -> dict[str, list[Points]]:
    """The test strokes, at least twenty kinds; a few are groups."""
    return {
        "line100": [np.array([[0.0, 0.0], [100.0, 30.0]])],
        "square20": [20 * polygon((0, 0), (1, 0), (1, 1), (0, 1))],
        "square2": [2 * polygon((0, 0), (1, 0), (1, 1), (0, 1))],
        "star30": [star(30.0)],
        "hatch_rect": [hatch_rect()],
        "hatch_zig": [zigzag(40, 0.8, 40.0)],
        "zigzag3": [zigzag(60, 2.0, 2.2)],
        "zigzag0.7": [zigzag(80, 0.5, 0.5)],
        "circle0.5": [circle(0.5)],
        "circle2.5": [circle(2.5)],
        "circle10": [circle(10.0)],
        "circle50": [circle(50.0)],
        "ellipse": [circle(20.0) * (1.0, 0.3)],
        "spiral": [spiral(12, 2.0, 2000)],
        "cursive": [cursive(5.0)],
        "cursive_small": [cursive(1.5, 7)],
        "hilbert5": [hilbert(5, 2.0)],
        "gosper3": [gosper(3, 2.0)],
        "scribble": [scribble(60)],
        "noisy": [noisy(100.0, 0.01)],
        "random_walk": [walk(300, 1.0)],
        "coast": [coast(5, 30.0, roughness=0.12)],
        "coast_rough": [coast(7, 30.0)],
        "text4": letters(4.0),
        "text15": letters(15.0),
    }


def _placed(group: list[Points], columns: int, dx: float, dy: float, count: int) -> list[Points]:
    return [p + np.array([dx * (k % columns), dy * (k // columns)]) for k in range(count) for p in group]


def _words(count: int, rng: np.random.Generator) -> list[Points]:
    return [cursive(2.0, s, int(rng.integers(3, 9))) + np.array([30.0 * (s % 6), 6.0 * (s // 6)]) for s in range(count)]


def drawings() -> dict[str, list[Points]]:
    """Ten and more drawings, from hatching to one stroke of 100,000 vertices."""
    rng = np.random.default_rng(11)
    beziers = [bezier([tuple(q) for q in rng.uniform(0, 180, (4, 2))]) for _ in range(150)]
    dots = [rng.uniform(0, 150, (1, 2)) for _ in range(800)]
    return {
        "lines": [np.sort(rng.uniform(0, 200, (2, 2)), axis=0) for _ in range(300)],
        "hatching": _placed([hatch_rect()], 4, 45.0, 25.0, 12),
        "squares": [a * polygon((0, 0), (1, 0), (1, 1), (0, 1)) for a in np.geomspace(1.0, 100.0, 120)],
        "circles": [circle(r) + rng.uniform(60, 120, 2) for r in np.geomspace(0.5, 50.0, 150)],
        "beziers": beziers,
        "spiral": [spiral(30, 2.0, 8000)],
        "handwriting": [
            cursive(2.0, s, int(rng.integers(3, 9))) + np.array([30.0 * (s % 6), 6.0 * (s // 6)]) for s in range(120)
        ],
        "text": _placed(letters(5.0), 8, 22.0, 8.0, 48),
        "map": [coast(5, 12.0, s, 0.12) + np.array([30.0 * (s % 6), 30.0 * (s // 6)]) for s in range(24)],
        "stipple": dots,
        "hilbert7": [hilbert(7, 1.2)],
        "gosper4": [gosper(4, 2.0)],
        "scribble": [scribble(400, 9)],
        "spiral100k": [spiral(120, 0.8, 100_000)],
    }


# --- reference planners ------------------------------------------------------------------------------------------------


def judged(points: Points, limits: Limits) -> tuple[PathSet, Points]:
    """The path as far as the tolerance can tell (thinned to half of it), and its caps: by curvature where it is smooth, by
    junction deviation where it is not, 0 at the ends."""
    kept = thinned(points, 0.5 * limits.tolerance_mm)
    paths = path_set([points[kept]], [None], limits.tolerance_mm)
    corner = speed.corner_cap(paths.turn_rad, limits.acceleration_mm_s2, limits.tolerance_mm)
    bend = np.sqrt(limits.acceleration_mm_s2 / np.maximum(paths.curvature, 1e-9))
    cap = np.minimum(limits.speed_mm_s, np.where(paths.sharp, corner, bend))
    cap[[0, -1]] = 0.0
    return paths, cap


def lower_bound(points: Points, limits: Limits) -> float:
    """Seconds of the acceleration-limited bound."""
    paths, cap = judged(points, limits)
    grid = speed.make_grid(paths, cap, np.full(len(cap) - 1, limits.speed_mm_s), limits, 0.01)
    v = speed.fastest(grid, grid.cap_mm_s, np.full(len(grid.s_mm), limits.acceleration_mm_s2), rounds=8, floor=0.01)
    return float((np.diff(grid.s_mm) * 2 / np.maximum(v[1:] + v[:-1], 1e-9)).sum())


def trapezoid(points: Points, limits: Limits) -> float:
    """Seconds of straight moves with junction-deviation speeds and speed changes bounded by A."""
    paths = path_set([points], [None], limits.tolerance_mm)
    a, top = limits.acceleration_mm_s2, limits.speed_mm_s
    cap2 = np.minimum(speed.corner_cap(paths.turn_rad, a, limits.tolerance_mm), top) ** 2
    cap2[[0, -1]] = 0.0
    length = paths.length_mm
    sigma = np.concatenate(([0.0], np.cumsum(2 * a * length)))
    v2 = np.minimum.accumulate(cap2 - sigma) + sigma
    v2 = np.minimum.accumulate((v2 + sigma)[::-1])[::-1] - sigma
    v = np.sqrt(np.maximum(v2, 0.0))
    peak = np.minimum(np.sqrt((v2[1:] + v2[:-1]) / 2 + a * length), top)
    cruise = length - (2 * peak**2 - v2[1:] - v2[:-1]) / (2 * a)
    return float(((2 * peak - v[1:] - v[:-1]) / a + np.maximum(cruise, 0.0) / peak).sum())


class AlongPath:
    """Jerk-limited speed along the path by ruckig between critical points, where acceleration is zero."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.otg, self.request, self.answer = Ruckig(1), InputParameter(1), Trajectory(1)
        self.request.max_acceleration = [limits.acceleration_mm_s2]
        self.request.max_jerk = [limits.jerk_mm_s3]

    def reach(self, v: float, d: float) -> float:
        """The greatest speed after distance d from speed v, both without acceleration: d = (v + u) / 2 T(u - v)."""
        a, j = self.limits.acceleration_mm_s2, self.limits.jerk_mm_s3
        low, high = 0.0, self.limits.speed_mm_s
        for _ in range(40):
            dv = (low + high) / 2
            t = 2 * math.sqrt(dv / j) if dv <= a * a / j else a / j + dv / a
            low, high = (dv, high) if (2 * v + dv) / 2 * t <= d else (low, dv)
        return v + low

    def seconds(self, points: Points, stop: bool) -> float:
        limits = self.limits
        paths, cap = judged(points, limits)
        cap = np.where(paths.sharp & stop, 0.0, cap)
        s = paths.s_mm
        must = [0, len(s) - 1, *np.flatnonzero(paths.sharp)] if stop else [0, len(s) - 1]
        critical = sorted(set(must))
        while True:
            v = [min(float(cap[k]), limits.speed_mm_s) * (1 - 1e-6) for k in critical]
            for i in range(1, len(v)):
                v[i] = min(v[i], self.reach(v[i - 1], s[critical[i]] - s[critical[i - 1]]) * (1 - 1e-6))
            for i in range(len(v) - 2, -1, -1):
                v[i] = min(v[i], self.reach(v[i + 1], s[critical[i + 1]] - s[critical[i]]) * (1 - 1e-6))
            total, more = 0.0, []
            for i in range(len(v) - 1):
                t, worst = self._leg(s, cap, critical[i], critical[i + 1], v[i], v[i + 1])
                total += t
                more += [worst] if worst >= 0 else []
            if not more:
                return total
            critical = sorted(set(critical + more))

    def _leg(self, s: Points, cap: Points, low: int, high: int, v0: float, v1: float) -> tuple[float, int]:
        """Seconds between two critical points, and the vertex between them whose cap is broken worst, or -1."""
        r = self.request
        r.current_position, r.target_position = [0.0], [float(s[high] - s[low])]
        r.current_velocity, r.target_velocity = [v0], [v1]
        r.max_velocity = [self.limits.speed_mm_s]
        try:
            self.otg.calculate(r, self.answer)
        except RuckigError:
            # Exactly at a case boundary (say 2 A^3 / J^2) ruckig finds nothing.
            r.target_position = [float(s[high] - s[low]) * (1 + 1e-6)]
            self.otg.calculate(r, self.answer)
        if high - low < 2:
            return self.answer.duration, -1
        p = self.answer.profiles[0][0]
        bounds = np.concatenate(([0.0], np.cumsum(p.t)))
        fine = np.unique(np.concatenate((bounds, np.linspace(0, bounds[-1], 12))))
        i = np.clip(np.searchsorted(bounds, fine, side="right") - 1, 0, 6)
        t, jerk = fine - bounds[i], np.array(p.j)[i]
        a, v, x = np.array(p.a)[i], np.array(p.v)[i], np.array(p.p)[i]
        way, fast = x + t * (v + t * (a / 2 + t * jerk / 6)), v + t * (a + t * jerk / 2)
        inner = np.arange(low + 1, high)
        over = np.interp(s[inner] - s[low], way, fast) / np.maximum(cap[inner], 1e-3)
        worst = int(np.argmax(over))
        return self.answer.duration, int(inner[worst]) if over[worst] > 1.002 else -1


# --- measuring ---------------------------------------------------------------------------------------------------------


@dataclass
class Quality:
    """Worst of a set of motions, over their limits and tolerance; sampled at 1 kHz."""

    speed: float = 0.0
    acceleration: float = 0.0
    jerk: float = 0.0
    off_path: float = 0.0
    left_out: float = 0.0
    jump: float = 0.0

    def add(self, motion: Motion, points: Points, limits: Limits) -> None:
        if not len(motion):
            self.left_out = max(self.left_out, float(np.hypot(*(points - motion.end_mm).T).max()) / limits.tolerance_mm)
            return
        q, v, a, j = motion.sample(np.arange(0.0, motion.total_s, 1e-3))
        self.speed = max(self.speed, float(np.hypot(*v.T).max()) / limits.speed_mm_s)
        self.acceleration = max(self.acceleration, float(np.hypot(*a.T).max()) / limits.acceleration_mm_s2)
        self.jerk = max(self.jerk, float(np.hypot(*j.T).max()) / limits.jerk_mm_s3)
        end_v = motion.ends()[1]
        self.jump = max(
            self.jump, float(np.abs(end_v[:-1] - motion.velocity_mm_s[1:]).max(initial=0.0)), float(np.abs(end_v[-1]).max())
        )
        self.off_path = max(self.off_path, off_polyline(q, points) / limits.tolerance_mm)
        fine = motion.sample(np.arange(0.0, motion.total_s, 2e-4))[0]
        self.left_out = max(self.left_out, off_polyline(points, fine) / limits.tolerance_mm)


def off_polyline(at: Points, line: Points) -> float:
    """The greatest distance of any of `at` from the polyline: exact for the segments near each point's nearest dense sample."""
    steps = np.hypot(*np.diff(line, axis=0).T)
    parts = np.maximum(1, np.ceil(steps / 0.25)).astype(np.int64)
    owner = np.repeat(np.arange(len(steps)), parts)
    share = (np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[owner]
    dense = line[owner] + share[:, None] * (line[owner + 1] - line[owner])
    dense, owner = np.concatenate((dense, line[-1:])), np.append(owner, len(steps) - 1)
    # Several neighbours, since the ends of a closed line are as near as each other.
    _, near = cKDTree(dense).query(at, k=min(6, len(dense)))
    best = np.full(len(at), np.inf)
    for column in np.reshape(near, (len(at), -1)).T:
        for k in (-1, 0, 1):
            i = np.clip(owner[column] + k, 0, len(steps) - 1)
            chord, offset = line[i + 1] - line[i], at - line[i]
            x = np.clip((offset * chord).sum(axis=1) / np.maximum((chord**2).sum(axis=1), 1e-300), 0, 1)
            best = np.minimum(best, np.hypot(*(offset - x[:, None] * chord).T))
    return float(best.max())


def legs_counter() -> Callable[[], int]:
    """Counts how often the last resort (a stop at every vertex) is used from now on."""
    count = [0]
    original = draw.legs

    def counted(*args: object) -> Motion:
        count[0] += 1
        return original(*args)  # type: ignore[arg-type]

    draw.legs = counted  # type: ignore[assignment]
    return lambda: count[0]


@dataclass
class Total:
    """Sums and worst of some strokes: seconds of each planner, CPU seconds, pieces."""

    seconds: dict[str, float] = field(
        default_factory=lambda: dict.fromkeys(("ours", "bound", "trapezoid", "ruckig", "stops"), 0.0)
    )
    cpu: float = 0.0
    pieces: int = 0
    worst: Quality = field(default_factory=Quality)

    def row(self, name: str) -> str:
        t, q = self.seconds, self.worst
        return (
            f"| {name} | {t['ours']:.1f} | {t['bound']:.1f} | {t['trapezoid']:.1f} | {t['ruckig']:.1f} | {t['stops']:.1f} "
            f"| {t['ours'] / t['bound']:.3f} | {t['ours'] / t['trapezoid']:.2f} | {t['ours'] / t['stops']:.2f} "
            f"| {t['ours'] / t['ruckig']:.2f} | {q.off_path:.3f} | {q.left_out:.3f} | {q.speed:.4f} "
            f"| {q.acceleration:.4f} | {q.jerk:.4f} | {q.jump:.1e} | {1e3 * t['ours'] / self.pieces:.1f} "
            f"| {100 * self.cpu / t['ours']:.2f} |"
        )


def stroke_table(name: str, limits: Limits, details: bool) -> dict[str, Total]:
    """One limit set's totals, of the reference strokes and of all; a line for each stroke when `details`."""
    along = AlongPath(limits)
    totals = {"reference": Total(), "all": Total()}
    if details:
        print(
            f"\n{name}: s and ratio to the bound; deviation over tolerance both ways; peaks over limits; ms per piece; CPU %\n"
        )
        print(
            "| stroke | ours s | bound s | ours | trapezoid | ruckig | stops | off | left out | v | a | j | ms/piece | CPU % |"
        )
        print("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|")
    for label, group in strokes().items():
        begun = time.process_time()
        motions = draw.draw_motions([Stroke(p) for p in group], limits, KINEMATICS)
        spent = time.process_time() - begun
        chosen = [totals["all"]] + ([totals["reference"]] if label in REFERENCE else [])
        quality = Quality()
        for motion, points in zip(motions, group, strict=True):
            for q in (quality, *(t.worst for t in chosen)):
                q.add(motion, points, limits)
        ours, count = sum(m.total_s for m in motions), sum(len(m) for m in motions)
        times = {
            "ours": ours,
            "bound": sum(lower_bound(p, limits) for p in group),
            "trapezoid": sum(trapezoid(p, limits) for p in group),
            "ruckig": sum(along.seconds(p, False) for p in group),
            "stops": sum(along.seconds(p, True) for p in group),
        }
        for total in chosen:
            total.cpu += spent
            total.pieces += count
            for key, value in times.items():
                total.seconds[key] += value
        if details:
            b = times["bound"]
            print(f"| {label} | {ours:.3f} | {b:.3f} | {ours / b:.2f} | {times['trapezoid'] / b:.2f} "
                  f"| {times['ruckig'] / b:.2f} | {times['stops'] / b:.2f} | {quality.off_path:.2f} | {quality.left_out:.2f} "
                  f"| {quality.speed:.3f} | {quality.acceleration:.3f} | {quality.jerk:.3f} "
                  f"| {1e3 * ours / count:.1f} | {100 * spent / ours:.1f} |", flush=True)  # fmt: skip
    return totals


def totals_table(totals: dict[str, dict[str, Total]], which: str) -> None:
    """The totals of all limit sets, of the strokes `which`."""
    print(f"\n{which} strokes, each limit set:\n")
    print("| limits | ours s | bound | trapezoid | ruckig | stops | ours/bound | ours/trapezoid | ours/stops "
          "| ours/ruckig | off | left out | v | a | j | jump mm/s | ms/piece | CPU % |\n" + "|---" * 18 + "|")  # fmt: skip
    for name, total in totals.items():
        print(total[which].row(name), flush=True)


def drawing_table(limits: Limits) -> None:
    """Whole drawings through the planner's door, travel included: CPU against the motion's time, first stroke, pieces."""
    settings = MotionSettings(limits, TRAVEL, KINEMATICS, PenTiming(0.1, 0.1, 0.02), PAGE)
    print(
        "\n| drawing | strokes | vertices | draw s | travel s | ours/bound | trapezoid/bound | ms/piece "
        "| first stroke ms | CPU s | CPU % |"
    )
    print("|---" * 11 + "|")
    for label, group in drawings().items():
        layer = Layer(1, label, tuple(Stroke(np.asarray(p, dtype=np.float64)) for p in group))
        drawn = moved = 0.0
        pieces, first = 0, math.nan
        begun = time.process_time()
        for action in plan([layer], settings, np.zeros(2), None):
            if isinstance(action, Draw):
                first = time.process_time() - begun if math.isnan(first) else first
                drawn += action.motion.total_s
                pieces += len(action.motion)
            elif isinstance(action, Travel):
                moved += action.motion.total_s
        spent = time.process_time() - begun
        lines = [p for p in group if len(p) > 1]
        bound = sum(lower_bound(p, limits) for p in lines) or math.nan
        other = sum(trapezoid(p, limits) for p in lines)
        print(f"| {label} | {len(group)} | {sum(len(p) for p in group)} | {drawn:.1f} | {moved:.1f} | {drawn / bound:.3f} "
              f"| {other / bound:.3f} | {1e3 * drawn / max(pieces, 1):.1f} | {1e3 * first:.0f} | {spent:.2f} "
              f"| {100 * spent / (drawn + moved):.2f} |", flush=True)  # fmt: skip


def run() -> None:
    """Print the tables of docs/motion.md."""
    stops = legs_counter()
    totals = {name: stroke_table(name, limits, details=name == "L2") for name, limits in LIMIT_SETS.items()}
    totals_table(totals, "reference")
    totals_table(totals, "all")
    drawing_table(LIMIT_SETS["L2"])
    print(f"\nstrokes that fell back to a stop at every vertex: {stops()}")


if __name__ == "__main__":
    run()
