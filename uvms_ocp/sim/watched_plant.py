"""Check states and telemetry of a user's plant before they are recorded."""

from __future__ import annotations

from typing import Any

import numpy as np

from uvms_ocp.control.external import is_finite
from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.tables import SERIES
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.hull import skid_points
from uvms_ocp.robot.signals import (
    Command,
    State,
)
from uvms_ocp.sim.plant import Plant
from uvms_ocp.sim.watched_estimator import require_state

# telemetry that reports and figures know
_EFFORTS = ("thrust", "torque", "thruster_energy", "joint_energy")
_REAL = "biuf"
_MAYBE_UNKNOWN = "thruster_energy"


class WatchedPlant(Plant):
    """A user's plant whose states and telemetry are checked before they are recorded."""

    def __init__(self, plant: Any, robot: Robot, name: str) -> None:
        """name: what messages call it. Raises `InvalidInput` for what is no `Plant`, or one that
        begins with a wrong state.
        """
        missing = [item for item in ("state", "step", "telemetry") if not hasattr(plant, item)]
        if missing:
            raise InvalidInput(
                f"plant {name} made {type(plant).__name__} without {', '.join(missing)}; make a"
                " Plant"
            )
        self._wrapped = plant
        self._robot = robot
        self._name = name
        n_thrusters = len(robot.description.thrusters)
        n_joints = robot.n_joints
        effort_shapes = ((n_thrusters,), (n_joints,), (n_thrusters,), ())
        self._shapes = dict[str, tuple[int, ...]](zip(_EFFORTS, effort_shapes, strict=True))
        self._shapes["contact"] = (len(skid_points(robot)),)
        self._shapes["current"] = (3,)
        self.state = self._checked_state(plant.state)

    def step(self, command: Command, dt: float) -> None:
        """Advance the user's plant by dt [s]. Raises `InvalidInput` for a state that cannot be."""
        self._wrapped.step(command, dt)
        self.state = self._checked_state(self._wrapped.state)

    def telemetry(self) -> dict[str, Any]:
        """Return the telemetry of the user's plant. Raises `InvalidInput` for what cannot be
        recorded, or not under that name.
        """
        telemetry = self._wrapped.telemetry()
        if not isinstance(telemetry, dict):
            raise InvalidInput(
                f"telemetry of plant {self._name} is {type(telemetry).__name__}; give a dict, empty"
                " for none"
            )
        efforts = [name for name in _EFFORTS if name in telemetry]
        if efforts and len(efforts) < len(_EFFORTS):
            raise InvalidInput(
                f"telemetry of plant {self._name} has {efforts[0]!r}; give all of"
                f" {', '.join(_EFFORTS)}, or none"
            )
        return {name: self._recorded(name, value) for name, value in telemetry.items()}

    def _checked_state(self, state: Any) -> State:
        if not isinstance(state, State):
            raise InvalidInput(
                f"state of plant {self._name} is {type(state).__name__}; give a State"
            )
        require_state(
            f"the state of plant {self._name}", self._robot, q=state.q, v=state.v, a=state.a
        )
        return state

    def _recorded(self, name: str, value: Any) -> np.ndarray:
        whose = f"telemetry of plant {self._name}"
        array = np.asarray(value)
        if array.dtype.kind not in _REAL or array.ndim > 1:
            raise InvalidInput(
                f"{whose} has {name} of shape {array.shape} and type {array.dtype}; give numbers"
                " (n,), or one"
            )
        if name not in self._shapes:
            if name in SERIES:
                raise InvalidInput(
                    f"{whose} has {name!r}, which means something else in records; rename it"
                )
            return array
        if array.dtype == float and array.shape == self._shapes[name] != () and is_finite(array):
            return array
        known_values = array
        if name == _MAYBE_UNKNOWN:
            known_values = array[~np.isnan(array)]
        problem = ""
        if array.shape != self._shapes[name]:
            problem = f"of shape {array.shape}"
        elif not np.isfinite(known_values).all():
            problem = "not finite"
        if problem:
            raise InvalidInput(
                f"{whose} has {name} {problem}; give finite numbers of shape {self._shapes[name]}"
            )
        return array.astype(float)
