"""A way through obstacles by clearance alone, without a plan."""

from __future__ import annotations

from collections.abc import Sequence

import coal

from uvms_ocp.control.velocity.kinematic import HierarchySolver
from uvms_ocp.mission.conditions import DONE, Below, Transition
from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import Phase
from uvms_ocp.model.loading import load_robot
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import IDEAL_SENSORS, sensors_of
from uvms_ocp.model.shapes.collision_model import CollisionModel
from uvms_ocp.model.shapes.obstacles import Obstacle, obstacle
from uvms_ocp.scenario import Scenario, pose_at
from uvms_ocp.scenarios.parts import always_underactuated, current_field, on, underactuation
from uvms_ocp.sim.currents import Current
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.solvers.hierarchy.cascade.solver import LexicographicQp
from uvms_ocp.tasks.altitude import MinimumAltitude
from uvms_ocp.tasks.attitude import HorizontalAttitude
from uvms_ocp.tasks.clearance import Clearance
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.joints import JointLimits, JointTracking
from uvms_ocp.tasks.pose import VehiclePose

_SELF = 0.03  # [m] between links, some of which are stowed 0.05 m apart


FIELD = (
    obstacle("boulder", coal.Sphere(0.6), (3.0, 0.8, -37.0)),
    obstacle("pillar", coal.Capsule(0.25, 3.0), (5.5, -0.7, -37.5)),
    obstacle("wreck", coal.Box(0.8, 0.8, 0.8), (8.0, 0.9, -37.2)),
)
"""None of them straight ahead, all of them in the way of the hull."""


def obstacle_field(
    *,
    robot: Robot | str = "girona_maris7_full",
    obstacles: Sequence[Obstacle] = FIELD,
    with_clearance: bool = True,
    threshold: float = 0.15,
    solver: HierarchySolver | None = None,
    plant: str = "dynamic",
    current: Current | Sequence[float] | None = None,
    noise: bool = False,
    seed: int = 0,
    dt: float = 1 / 100,
    duration: float = 150.0,
) -> Scenario:
    """A transit of 11 m past a boulder, a pillar and a wreck, kept clear of the whole robot by the clearance task.

    Every shape of the robot stays 0.1 m and more away from every obstacle, on the kinematic plant `threshold` [m] and more,
    and links stay apart; the way point is reached. with_clearance: False shows the collision. Reactive: an obstacle
    straight ahead would stop it, as it is no plan.
    """
    machine = load_robot(robot) if isinstance(robot, str) else robot
    q0 = machine.configuration(position=(0.0, 0.0, -37.0))
    goal = pose_at((11.0, 0.0, -37.0))
    tasks = [
        *underactuation(machine),
        JointLimits(),
        MinimumAltitude(),
        HorizontalAttitude(),
        Clearance(model=CollisionModel(machine, obstacles, self_collision=False), threshold=threshold, n_nearest=6),
        Clearance(name="SC", model=CollisionModel(machine), threshold=_SELF, margin=_SELF, n_nearest=6),
        VehiclePose(goal=goal),
        JointTracking(joints=machine.joint_names, goal=machine.home),
    ]
    gates = on("JL", "MAC", "HA", "PC", "MP", "SC", *(("CL",) if with_clearance else ()))
    arrived = Below(quantity="PC.position_error", limit=0.1)
    phase = Phase(name="A", title="transit", gates=gates, transitions=(Transition(to=DONE, when=(arrived,)),))
    return Scenario(
        name="obstacle_field",
        robot=machine,
        mission=Mission(hierarchy=Hierarchy(tasks), phases=always_underactuated(machine, (phase,))),
        environment=Environment(
            seafloor=FlatSeafloor(z=-40.0), current=current_field(current), obstacles=tuple(obstacles)
        ),
        start=q0,
        solver=solver or LexicographicQp(),
        plant=plant,
        sensors=sensors_of(machine.description) if noise else IDEAL_SENSORS,
        seed=seed,
        dt=dt,
        duration=duration,
        markers={"way point": tuple(goal.translation.tolist())},
    )
