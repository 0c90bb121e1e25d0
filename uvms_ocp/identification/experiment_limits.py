"""Limits of an experiment: thrust and slew of its commands, pool and tilt of the motion."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

import numpy as np

from uvms_ocp.checks import checked_constructor, checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.spatial import quaternion_to_matrix
from uvms_ocp.types import Array, Shape


@checked_dataclass(checked_constructor, eq=False)
class ExperimentLimits:
    """Limits of commands and motion. Raises InvalidInput for limits that are none, or that the start
    violates.
    """

    thrust: Annotated[Array, Shape("n_u", 2)]
    """(n_u, 2) [N, N m] lowest and highest command of each actuator, around 0."""
    pool: Annotated[Array, Shape(2, 3)]
    """(2, 3) [m] corners between which the hull stays, in W, from where the vehicle's origin
    begins.
    """
    hull: Annotated[Array, Shape(2, 3)] = field(default_factory=lambda: np.zeros((2, 3)))
    """(2, 3) [m] lowest and highest corner of a box that holds the hull, in B; default: the origin
    alone.
    """
    slew: float = np.inf
    """[N/s, N m/s] largest rate at which a command may change."""
    tilt: float = 0.7
    """[rad] largest angle between the vehicle's z axis and W's."""
    margin: float = 0.1
    """Share of the pool's half width and of the tilt that is kept free, as a vehicle with other numbers
    goes elsewhere.
    """

    def __post_init__(self) -> None:
        if not (_are_sizes(self.thrust * [-1, 1]) and _are_sizes(self.pool * [[-1], [1]])):
            raise InvalidInput(
                "thrust or pool without 0 inside given; allowed: lowest below 0, highest above,"
                " finite"
            )
        if not (self.slew > 0.0 and 0.0 < self.tilt < np.pi / 2 and 0.0 <= self.margin < 1.0):
            problem = f"slew = {self.slew}, tilt = {self.tilt}, margin = {self.margin} given"
            raise InvalidInput(
                f"{problem}; allowed: slew > 0, tilt from 0 to pi/2, margin from 0 to 1"
            )
        if not (self.hull[0] <= self.hull[1]).all():
            raise InvalidInput(
                f"hull {self.hull.tolist()} given; allowed: its lowest corner, then its highest"
            )
        if not (self.room > 0.0).all():
            raise InvalidInput(
                f"hull of {_sides(self.hull)} m in a pool of {_sides(self.pool)} m given; give a"
                " pool that leaves it room"
            )

    @property
    def room(self) -> np.ndarray:
        """(3,) [m] that the vehicle can go either way along each axis before its hull, unturned, comes to
        a wall.
        """
        return np.asarray(((self.pool - self.hull) * [[-1.0], [1.0]]).min(axis=0))

    def swept(self, x: np.ndarray) -> np.ndarray:
        """Compute the (2, 3) [m] lowest and highest corner of a box in W around the hull at all
        states x (n, n_x) [as `StageFunctions`].
        """
        R = _rotations(x[:, 3:7])
        middle = x[:, :3] + R @ self.hull.mean(axis=0)
        reach = np.abs(R) @ (np.diff(self.hull, axis=0)[0] / 2)
        return np.array([(middle - reach).min(axis=0), (middle + reach).max(axis=0)])

    def kept(self, commands: np.ndarray, step: float) -> np.ndarray:
        """Clip commands (n, n_u) [N, N m], a step [s] apart, to thrust and slew; they begin from
        0.
        """
        limited = np.empty_like(commands)
        before = np.zeros(commands.shape[1])
        for k, command in enumerate(commands):
            limited[k] = self.after(before, command, step)
            before = limited[k]
        return limited

    def after(self, before: np.ndarray, command: np.ndarray, step: float) -> np.ndarray:
        """Return the allowed command nearest to `command`, a step [s] after the command `before`; all
        (n_u,) [N, N m].
        """
        largest_change = self.slew * step
        within_thrust = np.clip(command, *self.thrust.T)
        return np.asarray(np.clip(within_thrust, before - largest_change, before + largest_change))

    def beyond(self, x: np.ndarray, margin: float | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Compute by how much states x (n, n_x) leave pool and tilt (n, 4) [-, in half widths], and
        the slope (n, 4, 7) with their poses.

        margin: share that is kept free; that of the limits by default.
        """
        if margin is None:
            margin = self.margin
        remaining = 1.0 - margin
        distances = np.zeros((len(x), 4))
        slope = np.zeros((len(x), 4, 7))
        distances[:, :3], slope[:, :3] = self._distances(x)
        # The root of qx^2 + qy^2 is the sine of half the tilt.
        half_tilt_sine = np.maximum(np.hypot(x[:, 3], x[:, 4]), 1e-9)
        largest_sine = np.sin(remaining * self.tilt / 2)
        distances[:, 3] = half_tilt_sine / largest_sine
        slope[:, 3, 3:5] = x[:, 3:5] / half_tilt_sine[:, None] / largest_sine
        excess = distances - [remaining, remaining, remaining, 1.0]
        return np.maximum(excess, 0.0), slope * (excess > 0.0)[:, :, None]

    def _distances(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute distances of the hull's outermost corners from the pool's middle (n, 3) [-, in
        half widths], and their slope (n, 3, 7).
        """
        hull_centre = self.hull.mean(axis=0)
        hull_half = np.diff(self.hull, axis=0)[0] / 2
        pool_half = np.diff(self.pool, axis=0)[0] / 2
        R = _rotations(x[:, 3:7])
        R_q = np.einsum("ijkl,nl->nijk", _ROTATION_CURVATURE, x[:, 3:7])
        offset = x[:, :3] + R @ hull_centre - np.asarray(self.pool.mean(axis=0))
        side = np.where(offset < 0.0, -1.0, 1.0)
        outermost = (
            hull_centre + side[:, :, None] * np.sign(R) * hull_half
        )  # corner in each direction
        by_position = np.tile(np.eye(3), (len(x), 1, 1))
        by_quaternion = np.einsum("nijk,nij->nik", R_q, outermost)
        slope = np.concatenate([by_position, by_quaternion], axis=2)
        distances = (np.abs(offset) + np.abs(R) @ hull_half) / pool_half
        return distances, slope * (side / pool_half)[:, :, None]


def _sides(corners: np.ndarray) -> str:
    """Write the lengths [m] of the sides of a box between corners (2, 3) [m]."""
    return " x ".join(f"{side:.4g}" for side in corners[1] - corners[0])


def _rotations(q: np.ndarray) -> np.ndarray:
    """Compute rotations (n, 3, 3) from B to W by quaternions q (n, 4)."""
    return np.moveaxis(np.array(quaternion_to_matrix(q.T)), -1, 0)


def _rotation_curvature() -> np.ndarray:
    """Compute (3, 3, 4, 4) second derivatives of a rotation matrix with its quaternion, in which it
    is a quadratic form.
    """
    e = np.eye(4)
    sums = (e[:, None] + e).reshape(-1, 4)
    of_each = _rotations(e) - np.eye(3)
    of_sums = _rotations(sums).reshape(4, 4, 3, 3) - np.eye(3)
    return np.moveaxis(of_sums - of_each[:, None] - of_each, (0, 1), (2, 3))


def _are_sizes(values: np.ndarray) -> bool:
    """Check that values are positive and finite."""
    return bool(((values > 0.0) & (values < np.inf)).all())


_ROTATION_CURVATURE = _rotation_curvature()
