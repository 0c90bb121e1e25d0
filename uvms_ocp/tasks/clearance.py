"""Clearance: the robot keeps away from obstacles and from itself."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import casadi as ca
import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.axis_reach import largest_change
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.shapes.collision_model import CollisionModel
from uvms_ocp.tasks.activation import Bell
from uvms_ocp.tasks.limits import approach_speed, row_acceleration, saturate
from uvms_ocp.tasks.task import (
    PositionLimit,
    Rows,
    StopAhead,
    Task,
    TaskClass,
    TickSymbols,
    require_positive,
)

_FAR = 1e3  # [m] stands for the distance of pairs that do not exist


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Clearance(Task):
    """CL: the nearest pairs of shapes stay `threshold` apart, one row per pair.

    Distances and gradients are numbers: they come from coal at every tick, as parameters. Raises `InvalidInput` for a
    number that is not positive or a model without pairs.
    """

    equality: ClassVar[bool] = False
    name: str = "CL"
    task_class: TaskClass = TaskClass.SAFETY
    model: CollisionModel
    n_nearest: int = 8
    threshold: float = 0.1  # [m]
    margin: float = 0.2  # [m] range of the bell beyond the threshold
    gain: float = 0.5  # [1/s]
    saturation: float = 0.5  # [m/s]
    _n_rows: int = field(init=False, repr=False)

    def __post_init__(self) -> None:
        require_positive(
            self.name, threshold=self.threshold, margin=self.margin, gain=self.gain, saturation=self.saturation
        )
        if self.n_nearest < 1:
            raise InvalidInput(f"{self.name}: n_nearest = {self.n_nearest}; give 1 or more")
        if self.model.n_pairs < 1:
            raise InvalidInput(f"{self.name}: a collision model without pairs; give obstacles or self_collision=True")
        object.__setattr__(self, "_n_rows", min(self.n_nearest, self.model.n_pairs))

    def position_limit(self, robot: Robot) -> PositionLimit:
        """Every pair stays `threshold` apart, also those beyond the `n_nearest`."""
        return PositionLimit(
            quantity="clearance", lower=self.threshold, values=self.model.values, reach=self.model.reach
        )

    def n_parameters(self, robot: Robot) -> int:
        return 1 + self._n_rows * (2 + robot.n_v)

    def reference(self, t: float) -> np.ndarray:
        """Pairs that are far away and do not move."""
        return np.concatenate([np.full(1 + 2 * self._n_rows, _FAR), np.zeros(self._n_rows * self.model.n_v)])

    def parameters(self, t: float, q: np.ndarray, stop: StopAhead | None = None) -> np.ndarray:
        """The smallest distance now; of the nearest pairs distance, largest closing speed, and gradient.

        Distance and gradient are those of the place on the way to rest where the pair is nearest: on a curved path, or
        with a face that turns, that is nearer than the gradient of here and now tells. The speed is the one whose stop
        just leaves the threshold.
        """
        now, n = self.model.values(q), self._n_rows
        pairs, gradient, closing = np.argsort(now)[:n], np.zeros((n, self.model.n_v)), np.full(n, _FAR)
        lowest, worst = now[pairs], np.zeros(n, dtype=int)
        if stop is not None:
            pairs, lowest, worst = self._nearest_on_the_way(now, stop)
        for place in set(worst.tolist()):
            rows = np.flatnonzero(worst == place)
            where = q if stop is None or place == 0 else stop.configurations[place - 1]
            gradient[rows] = self.model.distances(where, pairs[rows]).gradient
            if stop is not None and place:
                # The way to rest grows with the square of the speed.
                room = (lowest[rows] - self.threshold) / (2.0 * stop.durations[place - 1])
                closing[rows] = room - gradient[rows] @ stop.velocity
        return np.concatenate([[now.min()], lowest, closing, gradient.ravel(order="F")])

    def _nearest_on_the_way(self, now: np.ndarray, stop: StopAhead) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pairs (n,) that come nearest, their smallest distance, and where that is: 0 now, k at the k-th place."""
        approach = float(largest_change(self.model.reach, np.abs(stop.velocity))) * stop.durations[-1]
        near = np.flatnonzero(now <= np.sort(now)[self._n_rows - 1] + approach)
        distances = np.array([now[near], *(self.model.values(place, near) for place in stop.configurations)])
        chosen = np.argsort(distances.min(axis=0))[: self._n_rows]
        return near[chosen], distances.min(axis=0)[chosen], distances.argmin(axis=0)[chosen]

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        n, robot = self._n_rows, symbols.robot
        distance, fastest = parameters[1 : 1 + n], parameters[1 + n : 1 + 2 * n]
        jacobian = ca.reshape(parameters[1 + 2 * n :], n, robot.n_v)
        closing = approach_speed(
            distance - self.threshold,
            gain=self.gain,
            deceleration=row_acceleration(jacobian, robot.limits.acceleration),
            dt=symbols.dt,
            saturation=self.saturation,
        )
        bell = Bell(self.threshold, self.threshold + self.margin)
        rates = [saturate(self.gain * (bell.end - distance[k]), self.saturation) for k in range(n)]
        return Rows(
            jacobian=jacobian,
            rate=ca.vertcat(*rates),
            lower=-ca.fmin(closing, fastest),
            upper=ca.SX.inf(n),
            activation=ca.vertcat(*(bell.decreasing(distance[k]) for k in range(n))),
            quantities={"clearance": parameters[0]},
        )
