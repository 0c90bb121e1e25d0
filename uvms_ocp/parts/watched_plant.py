"""Somebody else's plant, whose state and telemetry are looked at before they are recorded."""

from __future__ import annotations

from typing import Any

import numpy as np

from uvms_ocp.control.watched import require_numbers
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import Command, State
from uvms_ocp.parts.watched_estimator import require_normalized
from uvms_ocp.sim.contact import skid_points
from uvms_ocp.sim.plant import EFFORTS, Plant
from uvms_ocp.tables.series_table import SERIES

_REAL = "biuf"
_MAYBE_UNKNOWN = "thruster_energy"


class WatchedPlant(Plant):
    """Another one, asked."""

    def __init__(self, plant: Any, robot: Robot, name: str) -> None:
        """name: what messages call it. Raises `InvalidInput` for what is no `Plant`, or one that begins with a wrong state."""
        missing = [item for item in ("state", "step", "telemetry") if not hasattr(plant, item)]
        if missing:
            raise InvalidInput(f"plant {name} made {type(plant).__name__} without {', '.join(missing)}; make a Plant")
        self._theirs, self._robot, self._name = plant, robot, name
        n_thrusters, n_joints = len(robot.description.thrusters), robot.n_joints
        self._shapes: dict[str, tuple[int, ...]] = dict(
            zip(EFFORTS, ((n_thrusters,), (n_joints,), (n_thrusters,), ()), strict=True),
            contact=(len(skid_points(robot)),),
            current=(3,),
        )
        self.state = self._right(plant.state)

    def step(self, command: Command, dt: float) -> None:
        """Theirs, by dt [s]. Raises `InvalidInput` for a state that cannot be."""
        self._theirs.step(command, dt)
        self.state = self._right(self._theirs.state)

    def telemetry(self) -> dict[str, Any]:
        """Theirs. Raises `InvalidInput` for what cannot be recorded, or not under that name."""
        told = self._theirs.telemetry()
        if not isinstance(told, dict):
            raise InvalidInput(f"telemetry of plant {self._name} is {type(told).__name__}; give a dict, empty for none")
        given = [name for name in EFFORTS if name in told]
        if given and len(given) < len(EFFORTS):
            raise InvalidInput(
                f"telemetry of plant {self._name} has {given[0]!r}; give all of {', '.join(EFFORTS)}, or none"
            )
        return {name: self._recorded(name, value) for name, value in told.items()}

    def _right(self, state: Any) -> State:
        name, robot = self._name, self._robot
        if not isinstance(state, State):
            raise InvalidInput(f"state of plant {name} is {type(state).__name__}; give a State")
        whose = f"the state of plant {name}"
        require_numbers(whose, "q", state.q, (robot.n_q,))
        require_numbers(whose, "v", state.v, (robot.n_v,))
        if state.a is not None:
            require_numbers(whose, "a", state.a, (robot.n_v,))
        require_normalized(whose, robot, state.q)
        return state

    def _recorded(self, name: str, value: Any) -> np.ndarray:
        whose, array = f"telemetry of plant {self._name}", np.asarray(value)
        if array.dtype.kind not in _REAL or array.ndim > 1:
            raise InvalidInput(
                f"{whose} has {name} of shape {array.shape} and type {array.dtype}; give numbers (n,), or one"
            )
        if name not in self._shapes:
            if name in SERIES:
                raise InvalidInput(f"{whose} has {name!r}, which means something else in records; rename it")
            return array
        known = array[~np.isnan(array)] if name == _MAYBE_UNKNOWN else array
        if array.shape != self._shapes[name] or not np.isfinite(known).all():
            found = f"of shape {array.shape}" if array.shape != self._shapes[name] else "not finite"
            raise InvalidInput(f"{whose} has {name} {found}; give finite numbers of shape {self._shapes[name]}")
        return array.astype(float)
