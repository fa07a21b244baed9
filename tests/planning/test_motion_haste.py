"""The interior point's arithmetic against numeric derivatives, and that haste only ever takes time away."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from planning.geometry.stroke import Stroke
from planning.motion import barrier, haste, spline
from planning.motion.draw import draw_motions
from planning.motion.levelling import Block, Levelling, knots
from planning.motion.limits import Kinematics, Limits
from planning.motion.path import path_set
from planning.motion.plan import TICK_S
from tests.planning.motion_checks import assert_keeps_all_laws

Array = NDArray[np.float64]
COREXY = Kinematics(np.array([[80.0, 80.0], [80.0, -80.0]]), 25000.0)
L2 = Limits(150, 2000, 100e3, 0.05)
L5 = Limits(150, 2000, 400e3, 0.03)


def system(seed: int) -> tuple[barrier.Bounds, Array]:
    """Two zigzags with corners in one system, and control points near them."""
    rng = np.random.default_rng(seed)
    points = [np.stack((np.arange(5.0), (np.arange(5) % 2) * 1.0 + 5.0 * k), axis=-1) for k in range(2)]
    paths = path_set(points, [None, None], L2.tolerance_mm)
    levelling = Levelling(paths, np.zeros(2), L2, COREXY, 0.008)
    blocks = []
    for k, p in enumerate(points):
        rest = (np.stack((p[0], np.zeros(2), np.zeros(2))), np.stack((p[-1], np.zeros(2), np.zeros(2))))
        blocks.append(Block(k, paths.s_mm[paths.first[k]], paths.s_mm[paths.last[k]], *rest, False, False))
    intervals, ticks = knots(np.array([0.25, 0.2]), 0.008)
    lay = spline.layout(ticks * TICK_S, intervals, 0.008)
    share = np.clip(lay.time_s / lay.time_s[lay.first + intervals][lay.block], 0.0, 1.0)
    from_s, to_s = (np.array([getattr(b, name) for b in blocks])[lay.block] for name in ("from_s", "to_s"))
    s = from_s + (to_s - from_s) * np.where(lay.is_knot, share, 1.0)
    corner, of = levelling.corners_inside(blocks)
    at = np.interp(paths.s_mm[corner], s, lay.time_s)
    rows = levelling.system(blocks, lay, s, levelling.anchors(corner, of, at, lay), of, None)
    bounds = barrier.Bounds(lay, rows.target, rows.tangent, rows.room, rows.anchors, of, rows.fixed, levelling.speed,
                            levelling.accel, levelling.jerk, levelling.tolerance)  # fmt: skip
    control = rows.target + rng.normal(size=rows.target.shape) * 0.02
    control[rows.fixed.row] = rows.fixed.value
    return bounds, control


def squares(bounds: barrier.Bounds, control: Array) -> list[tuple[Array, Array]]:
    """Every squared ratio with its block, written out once more."""
    lay = bounds.lay
    q, v, a = lay.knot_values(control)
    j = np.diff(a, axis=0) / lay.spacing_s[:-1, None]
    normal = np.stack((-bounds.tangent[:, 1], bounds.tangent[:, 0]), axis=-1)
    knot, piece = lay.is_knot, lay.is_interval[:-1]
    at = sum(bounds.anchors.basis[k][:, None] * control[bounds.anchors.row + k] for k in range(4)) - bounds.anchors.target
    xx, xy, yy = bounds.anchors.metric.T
    corner = xx * at[:, 0] ** 2 + 2 * xy * at[:, 0] * at[:, 1] + yy * at[:, 1] ** 2
    sideways = ((q - bounds.target) * normal).sum(axis=1) / bounds.room
    return [
        ((np.hypot(*j.T)[piece] / bounds.jerk) ** 2, lay.block[:-1][piece]),
        ((np.hypot(*a.T)[knot] / bounds.acceleration) ** 2, lay.block[knot]),
        ((np.hypot(*v.T)[knot] / bounds.speed) ** 2, lay.block[knot]),
        (sideways[knot] ** 2, lay.block[knot]),
        (corner, bounds.anchor_block),
    ]


def barrier_value(bounds: barrier.Bounds, control: Array, u: Array, tau: Array) -> float:
    """Of both blocks together, as barrier.py has it in its first line, and its weak pull along the path."""
    lay = bounds.lay
    q = lay.knot_values(control)[0]
    along = np.where(lay.is_knot, ((q - bounds.target) * bounds.tangent).sum(axis=1) / bounds.tolerance, 0.0)
    count = np.add.reduceat(lay.is_knot.astype(float), lay.first)
    pull = barrier.TANGENTIAL * (tau / count)[lay.block] * along**2
    return float((tau * u).sum() - sum(np.log(u[of] - x).sum() for x, of in squares(bounds, control)) + pull.sum())


@pytest.mark.parametrize("seed", range(4))
def test_a_newton_step_is_one(seed: int) -> None:
    """Along a Newton step p the slope is -p H p and the bend p H p, whatever p is: both measured by differences."""
    bounds, control = system(seed)
    ratios = barrier.ratios(bounds, control)
    u = 1.3 * barrier.greatest(bounds, ratios)
    tau = np.array([30.0, 55.0]) / u
    step, step_u = barrier.newton(bounds, ratios, u, tau)
    assert not step[bounds.fixed.row].any()

    def value(x: float) -> float:
        return barrier_value(bounds, control + x * step, u + x * step_u, tau)

    e = 1e-4
    slope = (value(e) - value(-e)) / (2 * e)
    bend = (value(e) - 2 * value(0.0) + value(-e)) / e**2
    assert bend > 0
    assert slope == pytest.approx(-bend, rel=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_a_step_goes_up_to_the_first_bound(seed: int) -> None:
    bounds, control = system(seed)
    ratios = barrier.ratios(bounds, control)
    u = 1.1 * barrier.greatest(bounds, ratios)
    rng = np.random.default_rng(seed + 50)
    step, step_u = rng.normal(size=control.shape) * 0.05, rng.normal(size=2) * 0.01 * u
    reach = barrier.furthest(bounds, ratios, barrier.ratios(bounds, step, moving=True), u, step_u)
    for block in range(2):
        margins = []
        for x in (reach[block] * (1 - 1e-6), reach[block] * (1 + 1e-6)):
            there = squares(bounds, control + x * step)
            margins.append(min((u[of] + x * step_u[of] - square)[of == block].min() for square, of in there))
        assert margins[0] > 0 > margins[1]


@pytest.mark.parametrize(("points", "limits"), [
    (np.stack((np.arange(30) * 2.0, (np.arange(30) % 2) * 2.2), axis=-1), L2),
    (np.cumsum(np.random.default_rng(3).normal(size=(60, 2)), axis=0), L2),
    (np.cumsum(np.random.default_rng(3).normal(size=(60, 2)), axis=0), L5),
    (np.array([[0.0, 0], [2, 0], [2, 2], [0, 2], [0, 0]]), L5),
])  # fmt: skip
def test_haste_saves_time_and_keeps_every_law(monkeypatch: pytest.MonkeyPatch, points: Array, limits: Limits) -> None:
    (fast,) = draw_motions([Stroke(points)], limits, COREXY)
    assert_keeps_all_laws(fast, points, limits)
    monkeypatch.setattr(haste, "STEPS", ())
    (slow,) = draw_motions([Stroke(points)], limits, COREXY)
    assert fast.total_s < 0.998 * slow.total_s
