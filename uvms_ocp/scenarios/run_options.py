"""What every scenario can be told in the same words, and the `Scenario` made of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from uvms_ocp.arguments import Bound, Count, Finite, checked
from uvms_ocp.control.force.dynamic import VelocityGains
from uvms_ocp.control.load.learning import LoadLearning
from uvms_ocp.control.velocity.kinematic import HierarchySolver
from uvms_ocp.exceptions import NameNotFound
from uvms_ocp.mission.mission import Mission
from uvms_ocp.model.assembly.trim import with_trim
from uvms_ocp.model.files.description import TrimBody
from uvms_ocp.model.loading import load_robot
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import IDEAL_SENSORS, sensors_of
from uvms_ocp.model.shapes.obstacles import Obstacle
from uvms_ocp.scenario import Scenario
from uvms_ocp.sim.currents import Current, StillWater, UniformCurrent
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.faults import Fault
from uvms_ocp.sim.faults.notation import parse_faults
from uvms_ocp.sim.seafloor import FlatSeafloor, Seafloor
from uvms_ocp.solvers.hierarchy.active_set.solver import LexicographicActiveSet

Markers = Mapping[str, tuple[float, float, float]]


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RunOptions:
    """Options of every scenario. `run_options` makes them from keywords, which may give a robot or a current by less."""

    robot: Robot
    """The machine. As a keyword also the name of one."""
    seabed: Finite
    """[m] height of the floor in W, of a rough one between its protuberances."""
    current: Current = field(default_factory=StillWater)
    """Of the water. As a keyword also the velocity (3,) [m/s] in W of a uniform one."""
    solver: HierarchySolver = field(default_factory=LexicographicActiveSet)
    """Of the hierarchy."""
    plant: str = "dynamic"
    """What moves: `dynamic`, in water, or `kinematic`, whose velocities follow at once."""
    payload: TrimBody | None = None
    """A body that the dynamic plant carries and the controller does not know."""
    observer: bool = True
    """Whether the dynamic layer estimates and cancels disturbances."""
    learn_load: bool = False
    """Whether the dynamic layer learns what the tool carries, which needs the observer."""
    noise: bool = False
    """Whether sensors have the noise, rates and delays of the robot's file."""
    seed: Count = 0
    """Of everything random."""
    faults: tuple[Fault, ...] = ()
    """What goes wrong. As a keyword also texts, see `uvms_ocp.sim.faults.parse_fault`."""
    dt: Bound = 1 / 200
    """[s] control period."""
    duration: Bound = 120.0
    """[s] at which an incomplete mission is stopped."""

    def start(self, X_WB: pin.SE3, joints: ArrayLike | None = None) -> np.ndarray:
        """Configuration (n_q,) with the vehicle at X_WB; joints (n_joints,) [rad or m], stowed by default.

        Raises `InvalidInput` outside the joint limits.
        """
        quaternion = pin.Quaternion(X_WB.rotation).coeffs()
        return self.robot.configuration(position=X_WB.translation, quaternion=quaternion, joints=joints)

    def scenario(
        self,
        *,
        name: str,
        mission: Mission,
        start: np.ndarray,
        markers: Markers,
        seafloor: Seafloor | None = None,
        obstacles: Sequence[Obstacle] = (),
        plant_robot: Robot | None = None,
    ) -> Scenario:
        """The scenario of a mission from start (n_q,) [m, rad]; the floor is flat unless given.

        plant_robot: what moves, where it is not the robot that the controller knows. Raises `InvalidInput` and
        `NameNotFound` as `Scenario` does.
        """
        real = plant_robot or self.robot
        return Scenario(
            name=name,
            robot=self.robot,
            mission=mission,
            environment=Environment(
                seafloor=seafloor or FlatSeafloor(z=self.seabed), current=self.current, obstacles=tuple(obstacles)
            ),
            start=start,
            solver=self.solver,
            plant=self.plant,
            sensors=sensors_of(self.robot.description) if self.noise else IDEAL_SENSORS,
            gains=VelocityGains() if self.observer else VelocityGains(observer_vehicle=0.0),
            load=LoadLearning() if self.learn_load else None,
            plant_robot=real if self.payload is None else with_trim(real, [self.payload]),
            seed=self.seed,
            dt=self.dt,
            duration=self.duration,
            markers=markers,
            faults=self.faults,
        )


def run_options(
    given: Mapping[str, Any], *, robot: Robot | str = "girona_maris7_full", seabed: float = -40.0
) -> RunOptions:
    """The options that were given by keyword, `None` for the default; robot and seabed [m] are the scenario's own.

    Raises `NameNotFound` for an option or a robot that there is not, and `InvalidInput` for a current, a
    fault or a seed that is none.
    """
    known = [item.name for item in fields(RunOptions)]
    for name in given:
        if name not in known:
            raise NameNotFound("option of all scenarios", name, known)
    options = {"robot": robot, "seabed": seabed, **{name: value for name, value in given.items() if value is not None}}
    machine, current, faults = options.pop("robot"), options.pop("current", None), options.pop("faults", ())
    return RunOptions(
        robot=load_robot(machine) if isinstance(machine, str) else machine,
        current=field_of(current),
        faults=parse_faults((faults,) if isinstance(faults, str | Fault) else faults),
        **options,
    )


def field_of(given: Current | Sequence[float] | None) -> Current:
    """A current as it is; of a velocity given (3,) [m/s] in W the uniform one, still water for none."""
    if given is None:
        return StillWater()
    return UniformCurrent(given) if isinstance(given, Sequence | np.ndarray) else given
