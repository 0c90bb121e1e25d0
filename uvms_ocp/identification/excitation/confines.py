"""What an excitation must keep to: thrust, and the pool around where the vehicle begins."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from uvms_ocp.arguments.frozen import read_only
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.spatial import quaternion_to_matrix


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Limits:
    """Of commands and of motion. Raises InvalidInput for limits that do not hold what is there at the beginning."""

    thrust: np.ndarray
    """(n_u, 2) [N, N m] lowest and highest command of each actuator, around 0."""
    pool: np.ndarray
    """(2, 3) [m] corners between which the hull stays, in W, from where the vehicle's origin begins."""
    hull: np.ndarray = field(default_factory=lambda: np.zeros((2, 3)))
    """(2, 3) [m] lowest and highest corner of a box that holds the hull, in B; default: the origin alone."""
    slew: float = np.inf
    """[N/s, N m/s] by which a command may change."""
    tilt: float = 0.7
    """[rad] between the vehicle's z axis and W's."""
    margin: float = 0.1
    """[-] share of the pool's half width and of the tilt that is kept free: other numbers lead elsewhere."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "thrust", read_only(self.thrust, np.float64))
        object.__setattr__(self, "pool", read_only(self.pool, np.float64))
        object.__setattr__(self, "hull", read_only(self.hull, np.float64))
        if self.thrust.ndim != 2 or self.thrust.shape[1] != 2 or self.pool.shape != (2, 3):
            raise InvalidInput(
                f"thrust {self.thrust.shape}, pool {self.pool.shape} given; allowed: (n_u, 2) and (2, 3)"
            )
        if not (_are_sizes(self.thrust * [-1, 1]) and _are_sizes(self.pool * [[-1], [1]])):
            raise InvalidInput("thrust or pool without 0 inside given; allowed: lowest below 0, highest above, finite")
        if not (self.slew > 0.0 and 0.0 < self.tilt < np.pi / 2 and 0.0 <= self.margin < 1.0):
            given = f"slew = {self.slew}, tilt = {self.tilt}, margin = {self.margin} given"
            raise InvalidInput(f"{given}; allowed: slew > 0, tilt from 0 to pi/2, margin from 0 to 1")
        self._require_room()

    def _require_room(self) -> None:
        if self.hull.shape != (2, 3) or not (self.hull[0] <= self.hull[1]).all():
            raise InvalidInput(f"hull {self.hull.tolist()} given; allowed: its lowest corner, then its highest")
        if not (self.room > 0.0).all():
            sides = (" x ".join(f"{side:.4g}" for side in one[1] - one[0]) for one in (self.hull, self.pool))
            raise InvalidInput("hull of {} m in a pool of {} m given; give a pool that leaves it room".format(*sides))

    @property
    def room(self) -> np.ndarray:
        """(3,) [m] that the vehicle can go either way before the hull, turned as at first, comes to a wall."""
        return np.asarray(((self.pool - self.hull) * [[-1.0], [1.0]]).min(axis=0))

    @property
    def _middle(self) -> np.ndarray:
        return np.asarray(self.pool.mean(axis=0))

    @property
    def _half(self) -> np.ndarray:
        return np.asarray(np.diff(self.pool, axis=0)[0] / 2)

    def swept(self, x: np.ndarray) -> np.ndarray:
        """(2, 3) [m] lowest and highest corner of a box in W that holds the hull at all states x (n, n_x) [as `Stage`]."""
        R = _turned(x[:, 3:7])
        middle, reach = x[:, :3] + R @ self.hull.mean(axis=0), np.abs(R) @ (np.diff(self.hull, axis=0)[0] / 2)
        return np.array([(middle - reach).min(axis=0), (middle + reach).max(axis=0)])

    def kept(self, commands: np.ndarray, step: float) -> np.ndarray:
        """The commands (n, n_u) [N, N m], a step [s] apart, as near as thrust and slew allow; they begin from 0."""
        found, before = np.empty_like(commands), np.zeros(commands.shape[1])
        for k, wanted in enumerate(commands):
            before = found[k] = self.after(before, wanted, step)
        return found

    def after(self, before: np.ndarray, wanted: np.ndarray, step: float) -> np.ndarray:
        """The command (n_u,) [N, N m] nearest to wanted (n_u,) [N, N m], a step [s] after before (n_u,) [N, N m]."""
        most = self.slew * step
        return np.asarray(np.clip(np.clip(wanted, *self.thrust.T), before - most, before + most))

    def beyond(self, x: np.ndarray, margin: float | None = None) -> tuple[np.ndarray, np.ndarray]:
        """How far states x (n, n_x) leave pool and tilt (n, 4) [-, in half widths], and the slope with x (n, 4, 7).

        margin: [-] default: the limits' own.
        """
        left = 1.0 - (self.margin if margin is None else margin)
        far, slope = np.zeros((len(x), 4)), np.zeros((len(x), 4, 7))
        far[:, :3], slope[:, :3] = self._far(x)
        # The root of qx^2 + qy^2 is the sine of half the tilt.
        leaning, most = np.maximum(np.hypot(x[:, 3], x[:, 4]), 1e-9), np.sin(left * self.tilt / 2)
        far[:, 3], slope[:, 3, 3:5] = leaning / most, x[:, 3:5] / leaning[:, None] / most
        over = far - [left, left, left, 1.0]
        return np.maximum(over, 0.0), slope * (over > 0.0)[:, :, None]

    def _far(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far the hull's outermost corners are from the pool's middle (n, 3) [-, in half widths]; slope (n, 3, 7)."""
        centre, size = self.hull.mean(axis=0), np.diff(self.hull, axis=0)[0] / 2
        R, with_q = _turned(x[:, 3:7]), np.einsum("ijkl,nl->nijk", _BENT, x[:, 3:7])
        off = x[:, :3] + R @ centre - self._middle
        side = np.where(off < 0.0, -1.0, 1.0)
        corner = centre + side[:, :, None] * np.sign(R) * size  # the outermost in each direction
        slope = np.concatenate([np.tile(np.eye(3), (len(x), 1, 1)), np.einsum("nijk,nij->nik", with_q, corner)], axis=2)
        return (np.abs(off) + np.abs(R) @ size) / self._half, slope * (side / self._half)[:, :, None]


def _turned(q: np.ndarray) -> np.ndarray:
    """(n, 3, 3) [-] from B to W by quaternions q (n, 4) [-]."""
    return np.moveaxis(np.array(quaternion_to_matrix(q.T)), -1, 0)


def _bent() -> np.ndarray:
    """(3, 3, 4, 4) [-] second derivatives of a rotation matrix with its quaternion, in which it is a quadratic form."""
    e = np.eye(4)
    one = _turned(e) - np.eye(3)
    both = _turned((e[:, None] + e).reshape(-1, 4)).reshape(4, 4, 3, 3) - np.eye(3)
    return np.moveaxis(both - one[:, None] - one, (0, 1), (2, 3))


_BENT = _bent()


def _are_sizes(values: np.ndarray) -> bool:
    return bool(((values > 0.0) & (values < np.inf)).all())
