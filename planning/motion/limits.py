"""What the motion must stay within, and how machine millimetres become motor steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds on the XY motion: |v|, |a|, |j| as Euclidean norms, and how far the pen may leave its path.

    Raises ValueError for a bound that is not positive and finite.
    """

    speed_mm_s: float
    acceleration_mm_s2: float
    jerk_mm_s3: float
    tolerance_mm: float = 0.02

    def __post_init__(self) -> None:
        for name in ("speed_mm_s", "acceleration_mm_s2", "jerk_mm_s3", "tolerance_mm"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"{name} must be positive and finite, not {value}")


@dataclass(frozen=True, eq=False, slots=True)
class Kinematics:
    """Motor steps = `steps_per_mm` (2, 2) @ machine millimetres; row i is motor i + 1.

    A cartesian machine has a diagonal matrix; CoreXY (AxiDraw) has motor 1 = x + y, motor 2 = x - y, and so its fastest
    direction along the axes is set by the sum. `max_step_rate` is what one motor can be stepped at, in steps per second.

    Raises ValueError for a matrix that cannot be inverted.
    """

    steps_per_mm: NDArray[np.float64]
    max_step_rate: float

    def __post_init__(self) -> None:
        if self.steps_per_mm.shape != (2, 2) or abs(np.linalg.det(self.steps_per_mm)) < 1e-9:
            raise ValueError("steps_per_mm must be a (2, 2) matrix that can be inverted")
        if not self.max_step_rate > 0:
            raise ValueError(f"max_step_rate must be positive, not {self.max_step_rate}")

    def steps(self, position_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Machine millimetres (n, 2) to motor steps (n, 2), not rounded."""
        return np.asarray(position_mm @ self.steps_per_mm.T)

    def millimetres(self, steps: NDArray[np.float64]) -> NDArray[np.float64]:
        """Motor steps (n, 2) to machine millimetres (n, 2)."""
        return np.asarray(np.linalg.solve(self.steps_per_mm, np.asarray(steps, dtype=np.float64).T).T)

    def max_speed_mm_s(self, direction: NDArray[np.float64]) -> float:
        """The greatest speed along the unit vector `direction` (2,) that both motors can step."""
        return float(self.max_step_rate / np.abs(self.steps_per_mm @ direction).max())

    def step_rate_share(
        self, velocity: NDArray[np.float64], acceleration: NDArray[np.float64], jerk: NDArray[np.float64],
        duration_s: NDArray[np.float64],
    ) -> NDArray[np.float64]:  # fmt: skip
        """The greatest rate of either motor in each piece (n,) over `max_step_rate`, from the states at its start (n, 2).

        Exact: a motor's rate is quadratic in time, so greatest at an end or where its acceleration is 0.
        """
        h = duration_s[:, None]
        v, a, j = self.steps(velocity), self.steps(acceleration), self.steps(jerk)
        still = np.clip(-a * np.sign(j), 0.0, h * np.abs(j)) / np.maximum(np.abs(j), 1e-300)
        rates = np.maximum(np.abs(v), np.abs(v + h * (a + h * j / 2)))
        rates = np.maximum(rates, np.abs(v + still * (a + still * j / 2)))
        return np.asarray(np.maximum(rates[:, 0], rates[:, 1]) / self.max_step_rate)

    @property
    def max_speed_any_direction_mm_s(self) -> float:
        """The greatest speed that both motors can step whatever the direction: max over directions is the row norm."""
        return float(self.max_step_rate / np.linalg.norm(self.steps_per_mm, axis=1).max())
