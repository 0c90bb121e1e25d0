"""A way through obstacles by clearance alone, without a plan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import coal

from uvms_ocp.arguments import Positive, checked
from uvms_ocp.mission.conditions import DONE, Below, Transition
from uvms_ocp.mission.phase import Phase
from uvms_ocp.model.shapes.collision_model import CollisionModel
from uvms_ocp.model.shapes.obstacles import Obstacle, obstacle
from uvms_ocp.scenario import Scenario, pose_at
from uvms_ocp.scenarios.parts import abort_phase, mission_of, on
from uvms_ocp.scenarios.run_options import run_options
from uvms_ocp.tasks.altitude import MinimumAltitude
from uvms_ocp.tasks.attitude import HorizontalAttitude
from uvms_ocp.tasks.clearance import Clearance
from uvms_ocp.tasks.joints import JointLimits, JointTracking
from uvms_ocp.tasks.pose import VehiclePose

_SELF = 0.03  # [m] between links, some of which are stowed 0.05 m apart
FIELD = (
    obstacle("boulder", coal.Sphere(0.6), (3.0, 0.8, -37.0)),
    obstacle("pillar", coal.Capsule(0.25, 3.0), (5.5, -0.7, -37.5)),
    obstacle("wreck", coal.Box(0.8, 0.8, 0.8), (8.0, 0.9, -37.2)),
)
"""None of them straight ahead, all of them in the way of the hull."""


@checked
def obstacle_field(
    *,
    obstacles: Sequence[Obstacle] = FIELD,
    with_clearance: bool = True,
    min_clearance: Positive = 0.15,
    **options: Any,
) -> Scenario:
    """A transit of 11 m past a boulder, a pillar and a wreck, kept clear of the whole robot by the clearance task.

    Every shape of the robot stays 0.1 m and more away from every obstacle, on the kinematic plant min_clearance [m] and
    more, and links stay apart; the way point is reached. with_clearance: False shows the collision. Reactive: an obstacle
    straight ahead would stop it, as it is no plan. options: those of `RunOptions`.
    """
    run = run_options(options)
    robot, goal = run.robot, pose_at((11.0, 0.0, -37.0))
    around = CollisionModel(robot, obstacles, self_collision=False)
    tasks = [
        JointLimits(),
        MinimumAltitude(),
        HorizontalAttitude(),
        Clearance(model=around, threshold=min_clearance, n_nearest=6),
        Clearance(name="SC", model=CollisionModel(robot), threshold=_SELF, margin=_SELF, n_nearest=6),
        VehiclePose(goal=goal),
        JointTracking(joints=robot.joint_names, goal=robot.home),
    ]
    gates = on("JL", "MAC", "HA", "PC", "MP", "SC", *(("CL",) if with_clearance else ()))
    arrived = Below(quantity="PC.position_error", limit=0.1)
    phase = Phase(name="A", title="transit", gates=gates, transitions=(Transition(to=DONE, when=(arrived,)),))
    return run.scenario(
        name="obstacle_field",
        mission=mission_of(robot, tasks, (phase,), abort=abort_phase(*(name for name in gates if name != "PC"))),
        start=run.start(pose_at((0.0, 0.0, -37.0))),
        obstacles=obstacles,
        markers={"way point": tuple(goal.translation.tolist())},
    )
