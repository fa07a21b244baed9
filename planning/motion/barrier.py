"""A barrier for a system's bounds, tau u - sum log(u - ratio^2), and its Newton steps.

The ratios are those of jerk, acceleration, speed and distance to their bounds: norms of something linear in the control points.
So the barrier is convex in them and u together; with tau growing, u tends to the least squared ratio within which all bounds
can be kept at once. Each block has its own u and tau. Reference: Boyd and Vandenberghe, Convex Optimization, chapter 11.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.motion import banded, spline
from planning.motion.late import solveh_banded
from planning.motion.path import Array, Ints, Mask

# A weak wish to be where the profile is: the mean square of the distance along the path over the tolerance, against u.
TANGENTIAL = 0.002


@dataclass(frozen=True, eq=False, slots=True)
class Bounds:
    """What a system's rows must keep: knots' targets, tangents and room (M,), corners, given control points, and the limits."""

    lay: spline.Layout
    target: Array
    tangent: Array
    room: Array
    anchors: banded.Anchors
    anchor_block: Ints
    fixed: banded.Fixed
    speed: float
    acceleration: float
    jerk: float
    tolerance: float


@dataclass(frozen=True, eq=False, slots=True)
class Ratios:
    """Over their bounds: jerk, acceleration and speed (M, 2), distance to the path sideways and along it (M,); and the corners'
    offsets in mm (m, 2)."""

    jerk: Array
    acceleration: Array
    speed: Array
    sideways: Array
    along: Array
    corner: Array


@dataclass(frozen=True, eq=False, slots=True)
class _Term:
    """Ratios of one kind: the basis (3 or 4, M) that makes them of control points, values (M, 2), bound, margins (M,), and

    where they count.
    """

    basis: Array
    value: Array
    bound: float
    margin: Array
    where: Mask

    def inverse(self, power: int) -> Array:
        return np.where(self.where, self.margin**-power, 0.0)

    def tensor(self) -> tuple[Array, Array, Array]:
        """Second derivative by the quantity itself: 2 / (bound^2 margin) I + 4 value value^T / (bound margin)^2."""
        w, z = 2.0 * self.inverse(1) / self.bound**2, 4.0 * self.inverse(2) / self.bound**2
        x, y = self.value.T
        return w + z * x * x, z * x * y, w + z * y * y


def ratios(bounds: Bounds, control: Array, moving: bool = False) -> Ratios:
    """The ratios of these control points (M, 2); with `moving`, how they change when the control points change by so much."""
    lay, anchors = bounds.lay, bounds.anchors
    shifted = [spline.shifted(control, k) for k in range(4)]

    def combined(basis: Array, where: Mask) -> Array:
        out = basis[0][:, None] * shifted[0]
        for k in range(1, len(basis)):
            out += basis[k][:, None] * shifted[k]
        out[~where] = 0.0
        return np.asarray(out)

    position = combined(lay.value, lay.is_knot)
    offset = position if moving else np.where(lay.is_knot[:, None], position - bounds.target, 0.0)
    tx, ty = bounds.tangent.T
    at = np.zeros((len(anchors.row), 2)) if moving else -anchors.target
    for k in range(4):
        at = at + anchors.basis[k][:, None] * control[anchors.row + k]
    return Ratios(
        combined(lay.jerk, lay.is_interval) / bounds.jerk,
        combined(lay.acceleration, lay.is_knot) / bounds.acceleration,
        combined(lay.velocity, lay.is_knot) / bounds.speed,
        (offset[:, 1] * tx - offset[:, 0] * ty) / bounds.room,
        (offset[:, 0] * tx + offset[:, 1] * ty) / bounds.tolerance,
        at,
    )


def greatest(bounds: Bounds, r: Ratios) -> Array:
    """The greatest squared ratio of each block (B,)."""
    rows = np.maximum(np.maximum(_square(r.jerk), _square(r.acceleration)), np.maximum(_square(r.speed), r.sideways**2))
    out = np.maximum.reduceat(rows, bounds.lay.first)
    np.maximum.at(out, bounds.anchor_block, _corner_square(bounds, r))
    return np.asarray(out)


def constraints(bounds: Bounds) -> Array:
    """How many bounds each block has (B,)."""
    lay = bounds.lay
    out = np.add.reduceat(lay.is_interval + 3.0 * lay.is_knot, lay.first)
    np.add.at(out, bounds.anchor_block, 1.0)
    return np.asarray(out)


def balanced(bounds: Bounds, r: Ratios, u: Array) -> Array:
    """The tau (B,) for which u is best as it is."""
    return _sum_inverse(bounds, _terms(bounds, r, u), _sideways_margin(bounds, r, u), _corner_margin(bounds, r, u), 1)


def newton(bounds: Bounds, r: Ratios, u: Array, tau: Array) -> tuple[Array, Array]:
    """The Newton step of the control points (M, 2) and of u (B,). Raises LinAlgError when the system is not definite."""
    lay = bounds.lay
    terms = _terms(bounds, r, u)
    side, corner = _sideways_margin(bounds, r, u), _corner_margin(bounds, r, u)
    slope = tau - _sum_inverse(bounds, terms, side, corner, 1)
    bend = _sum_inverse(bounds, terms, side, corner, 2)
    count = np.add.reduceat(lay.is_knot.astype(np.float64), lay.first)
    pull = np.where(lay.is_knot, (2.0 * TANGENTIAL * tau / count)[lay.block], 0.0) / bounds.tolerance
    band = _hessian(bounds, r, terms, side, corner, pull)
    m = len(lay.block)
    # By the control points: the slope of the barrier, and of its slope by u.
    right = np.stack(
        (_gradient(bounds, r, terms, side, corner, 1, pull), -_gradient(bounds, r, terms, side, corner, 2)), axis=-1
    )
    band[banded.BANDS, bounds.fixed.row] += banded.FIXED * band[banded.BANDS].max()
    right[bounds.fixed.row] = 0.0
    solved = solveh_banded(
        band.reshape(banded.BANDS + 1, 2 * m), right.reshape(2 * m, 2), overwrite_ab=True, check_finite=False
    ).reshape(m, 2, 2)
    solved[bounds.fixed.row] = 0.0

    def dot(x: Array, y: Array) -> Array:
        return np.asarray(np.add.reduceat((x * y).sum(axis=1), lay.first))

    cross = right[:, :, 1]
    step_u = -(slope - dot(cross, solved[:, :, 0])) / np.maximum(bend - dot(cross, solved[:, :, 1]), 1e-12 * bend)
    return -solved[:, :, 0] - solved[:, :, 1] * step_u[lay.block][:, None], step_u


def furthest(bounds: Bounds, r: Ratios, change: Ratios, u: Array, step_u: Array) -> Array:
    """How much of a step, of `change` to the ratios and `step_u` to u, keeps every margin of each block (B,) above 0."""
    lay, of = bounds.lay, bounds.anchor_block
    at, du = u[lay.block], step_u[lay.block]
    rows = _reach(r.sideways * change.sideways, change.sideways**2, at - r.sideways**2, du)
    for x, y in ((r.jerk, change.jerk), (r.acceleration, change.acceleration), (r.speed, change.speed)):
        rows = np.minimum(rows, _reach((x * y).sum(axis=1), _square(y), at - _square(x), du))
    out = np.minimum.reduceat(rows, lay.first)
    here, there = _metric(bounds.anchors, r.corner), _metric(bounds.anchors, change.corner)
    margin = u[of] - (here * r.corner).sum(axis=1)
    np.minimum.at(out, of, _reach((here * change.corner).sum(axis=1), (there * change.corner).sum(axis=1), margin, step_u[of]))
    return np.asarray(out)


# --- parts -------------------------------------------------------------------------------------------------------------


def _square(x: Array) -> Array:
    return np.asarray(x[:, 0] ** 2 + x[:, 1] ** 2)


def _metric(anchors: banded.Anchors, x: Array) -> Array:
    xx, xy, yy = anchors.metric.T
    return np.stack((xx * x[:, 0] + xy * x[:, 1], xy * x[:, 0] + yy * x[:, 1]), axis=-1)


def _corner_square(bounds: Bounds, r: Ratios) -> Array:
    return np.asarray((r.corner * _metric(bounds.anchors, r.corner)).sum(axis=1))


def _reach(linear: Array, square: Array, margin: Array, du: Array) -> Array:
    """The x up to which margin + (du - 2 linear) x - square x^2 is above 0."""
    b = linear - 0.5 * du
    low = b + np.sqrt(np.maximum(b * b + square * margin, 0.0))
    return np.where(low > 0.0, margin / np.maximum(low, 1e-300), np.inf)


def _terms(bounds: Bounds, r: Ratios, u: Array) -> list[_Term]:
    lay = bounds.lay
    at = u[lay.block]
    return [
        _Term(lay.jerk, r.jerk, bounds.jerk, at - _square(r.jerk), lay.is_interval),
        _Term(lay.acceleration, r.acceleration, bounds.acceleration, at - _square(r.acceleration), lay.is_knot),
        _Term(lay.velocity, r.speed, bounds.speed, at - _square(r.speed), lay.is_knot),
    ]


def _sideways_margin(bounds: Bounds, r: Ratios, u: Array) -> Array:
    return np.where(bounds.lay.is_knot, u[bounds.lay.block] - r.sideways**2, np.inf)


def _corner_margin(bounds: Bounds, r: Ratios, u: Array) -> Array:
    return np.asarray(u[bounds.anchor_block] - _corner_square(bounds, r))


def _sum_inverse(bounds: Bounds, terms: list[_Term], side: Array, corner: Array, power: int) -> Array:
    rows = side**-power
    for term in terms:
        rows = rows + term.inverse(power)
    out = np.add.reduceat(rows, bounds.lay.first)
    np.add.at(out, bounds.anchor_block, corner**-power)
    return np.asarray(out)


def _hessian(bounds: Bounds, r: Ratios, terms: list[_Term], side: Array, corner: Array, pull: Array) -> Array:
    """By the control points, as bands."""
    lay, anchors = bounds.lay, bounds.anchors
    m = len(lay.block)
    tx, ty = bounds.tangent.T
    across = (2.0 / side + 4.0 * r.sideways**2 / side**2) / bounds.room**2
    along = pull / bounds.tolerance
    place = (across * ty * ty + along * tx * tx, (along - across) * tx * ty, across * tx * tx + along * ty * ty)
    parts = [(term.basis, term.tensor()) for term in terms] + [(lay.value, place)]
    band = np.zeros((banded.BANDS + 1, m, 2))
    for a in range(4):
        for b in range(a, 4):
            xx, xy, yy = np.zeros(m), np.zeros(m), np.zeros(m)
            for basis, tensor in parts:
                if b < len(basis):
                    share = basis[a] * basis[b]
                    xx += share * tensor[0]
                    xy += share * tensor[1]
                    yy += share * tensor[2]
            level, end = banded.BANDS - 2 * (b - a), m - b
            band[level, b:, 0] += xx[:end]
            band[level, b:, 1] += yy[:end]
            band[level - 1, b:, 1] += xy[:end]
            if b > a:
                band[level + 1, b:, 0] += xy[:end]
    gx, gy = _metric(anchors, r.corner).T
    metric = 2.0 * anchors.metric / corner[:, None] + (4.0 / corner**2)[:, None] * np.stack(
        (gx * gx, gx * gy, gy * gy), axis=-1
    )
    weighed = banded.Anchors(anchors.row, anchors.basis, anchors.target, metric)
    banded.add_anchors(band, np.zeros((m, 2)), weighed, np.ones(len(anchors.row)))
    return band


def _gradient(
    bounds: Bounds, r: Ratios, terms: list[_Term], side: Array, corner: Array, power: int, pull: Array | None = None
) -> Array:
    """By the control points (M, 2): of sum margin^-power / power, and of the pull towards the path's points."""
    lay, anchors = bounds.lay, bounds.anchors
    m = len(lay.block)
    across = 2.0 * r.sideways * side**-power / bounds.room
    place = across[:, None] * np.stack((-bounds.tangent[:, 1], bounds.tangent[:, 0]), axis=-1)
    if pull is not None:
        place += (pull * r.along)[:, None] * bounds.tangent
    parts = [(term.basis, (2.0 / term.bound * term.inverse(power))[:, None] * term.value) for term in terms]
    out = np.zeros((m, 2))
    for basis, part in [*parts, (lay.value, place)]:
        for a in range(len(basis)):
            out[a:] += (basis[a][:, None] * part)[: m - a]
    push = (2.0 * corner**-power)[:, None] * _metric(anchors, r.corner)
    for a in range(4):
        np.add.at(out, anchors.row + a, anchors.basis[a][:, None] * push)
    return out
