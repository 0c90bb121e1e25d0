"""What an excitation must keep to: thrust, and the pool around where the vehicle begins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.arguments.frozen import read_only
from uvms_ocp.exceptions import InvalidInput


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Limits:
    """Of commands and of motion. Raises InvalidInput for limits that do not hold what is there at the beginning."""

    thrust: np.ndarray
    """(n_u, 2) [N, N m] lowest and highest command of each actuator, around 0."""
    pool: np.ndarray
    """(2, 3) [m] corners between which the vehicle's origin stays, in W, from where it begins."""
    slew: float = np.inf
    """[N/s, N m/s] by which a command may change."""
    tilt: float = 0.7
    """[rad] between the vehicle's z axis and W's."""
    margin: float = 0.1
    """[-] share of the pool's half width and of the tilt that is kept free: other numbers lead elsewhere."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "thrust", read_only(self.thrust, np.float64))
        object.__setattr__(self, "pool", read_only(self.pool, np.float64))
        if self.thrust.ndim != 2 or self.thrust.shape[1] != 2 or self.pool.shape != (2, 3):
            raise InvalidInput(
                f"thrust {self.thrust.shape}, pool {self.pool.shape} given; allowed: (n_u, 2) and (2, 3)"
            )
        if not (_are_sizes(self.thrust * [-1, 1]) and _are_sizes(self.pool * [[-1], [1]])):
            raise InvalidInput("thrust or pool without 0 inside given; allowed: lowest below 0, highest above, finite")
        if not (self.slew > 0.0 and 0.0 < self.tilt < np.pi / 2 and 0.0 <= self.margin < 1.0):
            given = f"slew = {self.slew}, tilt = {self.tilt}, margin = {self.margin} given"
            raise InvalidInput(f"{given}; allowed: slew > 0, tilt from 0 to pi/2, margin from 0 to 1")

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
        middle, half = self.pool.mean(axis=0), np.diff(self.pool, axis=0)[0] / 2
        far = (x[:, :3] - middle) / half
        # The root of qx^2 + qy^2 is the sine of half the tilt.
        leaning, most = np.maximum(np.hypot(x[:, 3], x[:, 4]), 1e-9), np.sin(left * self.tilt / 2)
        slope = np.zeros((len(x), 4, 7))
        slope[:, range(3), range(3)] = np.sign(far) / half
        slope[:, 3, 3:5] = x[:, 3:5] / leaning[:, None] / most
        over = np.column_stack([np.abs(far) - left, leaning / most - 1.0])
        return np.maximum(over, 0.0), slope * (over > 0.0)[:, :, None]


def _are_sizes(values: np.ndarray) -> bool:
    return bool(((values > 0.0) & (values < np.inf)).all())
