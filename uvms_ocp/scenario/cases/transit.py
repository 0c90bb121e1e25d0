"""Transits of the whole vehicle: over a rough floor at minimum altitude, and past obstacles by
clearance alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Annotated, Any

import coal
import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.mission.phase import Below
from uvms_ocp.record.meta_values import DONE
from uvms_ocp.robot.shapes.collision_model import CollisionModel
from uvms_ocp.robot.shapes.obstacles import Obstacle, obstacle
from uvms_ocp.scenario.options import SAFETY, abort_phase, mission_of, phase_of, run_options
from uvms_ocp.scenario.scenario import Scenario, pose_at
from uvms_ocp.sim.rough_seafloor import HeightField
from uvms_ocp.tasks import (
    Clearance,
    HorizontalAttitude,
    JointLimits,
    JointTracking,
    MinimumAltitude,
    VehiclePose,
)
from uvms_ocp.types import Positive, Range

# A low transit over a rough floor: one cell of Table 2 of the paper.

# [m] height of the way point: low enough for the minimum altitude to decide the height everywhere
_ABOVE_FLOOR = 0.8

Length = Annotated[float, Range(0.0, 2000.0)]
"""Length [m] of a transit, whose floor is drawn whole."""

_SELF = 0.03  # [m] between links, some of which are stowed 0.05 m apart
FIELD = (
    obstacle("boulder", coal.Sphere(0.6), (3.0, 0.8, -37.0)),
    obstacle("pillar", coal.Capsule(0.25, 3.0), (5.5, -0.7, -37.5)),
    obstacle("wreck", coal.Box(0.8, 0.8, 0.8), (8.0, 0.9, -37.2)),
)
"""Obstacles that are not straight ahead, but in the way of the hull."""


@checked
def transit(
    *, relief: str = "small", min_altitude: Positive = 1.0, length: Length = 30.0, **options: Any
) -> Scenario:
    """Return a transit of length [m] towards a way point near the floor, held up by the minimum
    altitude alone.

    relief: a name in `uvms_ocp.sim.rough_seafloor.RELIEFS`. min_altitude [m]: h_min. The floor is
    drawn from `seed`. The altimeter looks straight down and sees a slope only when above it: over
    steep protuberances a low minimum is not safe. options: those of `RunOptions`.
    """
    run = run_options(options)
    floor = HeightField.random(
        relief, z=run.seabed, centre=(length / 2, 0.0), extent=length + 20.0, seed=run.seed
    )
    below_start = product(np.linspace(-2.0, 2.0, 9), np.linspace(-1.0, 1.0, 5))
    ground = max(floor.height(x, y) for x, y in below_start)
    goal = pose_at((length, 0.0, max(run.seabed, floor.height(length, 0.0)) + _ABOVE_FLOOR))
    tasks = [
        JointLimits(),
        MinimumAltitude(threshold=min_altitude, margin=1.0),
        HorizontalAttitude(),
        VehiclePose(goal=goal),
    ]
    phase = phase_of(
        "A",
        "transit",
        ("JL", "MAC", "HA", "PC"),
        DONE,
        Below(quantity="PC.horizontal_error", limit=1.0),
    )
    return run.scenario(
        name="transit",
        mission=mission_of(run.robot, tasks, (phase,), abort=abort_phase("JL", "MAC", "HA")),
        start=run.start(pose_at((0.0, 0.0, ground + min_altitude + 1.5))),
        seafloor=floor,
        markers={"way point": tuple(goal.translation.tolist())},
    )


# A way through obstacles by clearance alone, without a plan.


@checked
def obstacle_field(
    *,
    obstacles: Sequence[Obstacle] = FIELD,
    with_clearance: bool = True,
    min_clearance: Positive = 0.15,
    **options: Any,
) -> Scenario:
    """Return a transit of 11 m past a boulder, a pillar and a wreck, kept clear of the whole robot
    by the clearance task.

    Every shape of the robot stays 0.1 m and more away from every obstacle, on the kinematic plant
    min_clearance [m] and more, and links stay apart; the way point is reached. with_clearance:
    False shows the collision. Reactive: an obstacle straight ahead would stop it, as it is no plan.
    options: those of `RunOptions`.
    """
    run = run_options(options)
    robot = run.robot
    goal = pose_at((11.0, 0.0, -37.0))
    around = CollisionModel(robot, obstacles, self_collision=False)
    if robot.n_joints:
        sc = [
            Clearance(
                name="SC", model=CollisionModel(robot), threshold=_SELF, margin=_SELF, n_nearest=6
            )
        ]
    else:
        sc = []
    posture = VehiclePose(goal=goal), JointTracking(joints=robot.joint_names, goal=robot.home)
    tasks = [*SAFETY, Clearance(model=around, threshold=min_clearance, n_nearest=6), *sc, *posture]
    on = (
        "JL",
        "MAC",
        "HA",
        "PC",
        "MP",
        *(task.name for task in sc),
    )
    if with_clearance:
        on = (*on, "CL")
    phase = phase_of("A", "transit", on, DONE, Below(quantity="PC.position_error", limit=0.1))
    return run.scenario(
        name="obstacle_field",
        mission=mission_of(
            robot, tasks, (phase,), abort=abort_phase(*(name for name in on if name != "PC"))
        ),
        start=run.start(pose_at((0.0, 0.0, -37.0))),
        obstacles=obstacles,
        markers={"way point": tuple(goal.translation.tolist())},
    )
