"""Clearance task: keep the robot away from obstacles and from itself."""

from __future__ import annotations

from dataclasses import field
from typing import ClassVar

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.robot.limits import PositionLimit
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.collision_model import CollisionModel
from uvms_ocp.tasks.activation import SmoothActivation
from uvms_ocp.tasks.approach_speed import saturate
from uvms_ocp.tasks.nearest_pairs import NearestPairs
from uvms_ocp.tasks.task import Rows, Task, TaskClass, TickSymbols, determined_by_goal
from uvms_ocp.types import Positive


@checked_dataclass(eq=False)
class Clearance(Task):
    """CL: the nearest pairs of shapes stay `threshold` apart, one row per pair.

    Distances and gradients are numbers, of `model`. Raises `InvalidInput` for a number that is not
    positive or a model without pairs.
    """

    equality: ClassVar[bool] = False
    symbolic_numbers: ClassVar[tuple[str, ...]] = ("threshold", "margin", "gain", "saturation")
    name: str = "CL"
    task_class: TaskClass = TaskClass.SAFETY
    model: CollisionModel
    """The pairs."""
    n_nearest: int = 8
    """Rows."""
    threshold: Positive = 0.1
    """[m] distance to be kept."""
    margin: Positive = 0.2
    """[m] range of the activation beyond the threshold."""
    gain: Positive = 0.5
    """[1/s] Rate that is asked for, per error."""
    saturation: Positive = 0.5
    """[m/s] Largest rate that is asked for."""
    _pairs: NearestPairs = field(init=False, repr=False)
    """See `nearest_pairs`."""

    def __post_init__(self) -> None:
        pairs = NearestPairs(
            task=self.name, model=self.model, n=self.n_nearest, threshold=self.threshold
        )
        object.__setattr__(self, "_pairs", pairs)

    @property
    def nearest_pairs(self) -> NearestPairs:
        """Pairs of `model`."""
        return self._pairs

    def position_limit(self, robot: Robot) -> PositionLimit:
        """Limit that keeps every pair `threshold` apart, also those beyond the `n_nearest`."""
        model = self.model
        return PositionLimit(
            quantity="clearance",
            lower=self.threshold,
            values=model.values,
            n=model.n_pairs,
            reach=model.reach,
        )

    def n_parameters(self, robot: Robot) -> int:
        return self._pairs.n_parameters

    @determined_by_goal
    def reference(self, t: float) -> np.ndarray:
        return self._pairs.far_away()

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        pairs = self._pairs.symbols(parameters)
        closeness = SmoothActivation(self.threshold, self.threshold + self.margin)
        rates = list[ca.SX]()
        activations = list[ca.SX]()
        for k in range(self._pairs.n_rows):
            way_out = closeness.end - pairs.distance[k]
            rates.append(saturate(self.gain * way_out, self.saturation))
            activations.append(closeness.decreasing(pairs.distance[k]))
        distance_left = pairs.distance - self.threshold
        approach = symbols.approach(self, distance_left, pairs.jacobian)
        return Rows(
            jacobian=pairs.jacobian,
            rate=ca.vertcat(*rates),
            lower=-ca.fmin(approach, pairs.closing),
            upper=ca.SX.inf(self._pairs.n_rows),
            activation=ca.vertcat(*activations),
            quantities={"clearance": pairs.smallest},
        )
