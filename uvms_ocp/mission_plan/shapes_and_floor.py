"""What surrounds a mission, as an optimal control problem takes it: one current, a level floor, obstacles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uvms_ocp.collision.collision_scene import collision_scene
from uvms_ocp.collision.coordinates import coordinates
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.mission_plan.above_floor import AboveFloor, rims_of
from uvms_ocp.mission_plan.greedy_way import GreedyWay
from uvms_ocp.mission_plan.kept_tasks import active
from uvms_ocp.mission_plan.margins import Margins
from uvms_ocp.mission_plan.stretches import Stretch
from uvms_ocp.ocp.clearance.shape_clearance import ShapeClearance
from uvms_ocp.ocp.terms import Term
from uvms_ocp.scenario import Scenario
from uvms_ocp.tasks.altitude import MinimumAltitude
from uvms_ocp.tasks.clearance import Clearance

_LEVEL = 0.05  # [m] by which a floor may differ along the way


def floor_along(scenario: Scenario, way: GreedyWay) -> float:
    """Height [m] of the floor below the way; raises `InvalidInput` where it is not level."""
    if not scenario.robot.n_vehicle:
        return -np.inf
    heights = [scenario.environment.seafloor.height(float(x), float(y)) for x, y in way.q[:, :2]]
    low, high = min(heights), max(heights)
    if high - low > _LEVEL:
        raise InvalidInput(
            f"the floor rises by {high - low:.2g} m along the way; a plan needs one that is level within {_LEVEL:g} m"
        )
    return high


def floor_terms(scenario: Scenario, stretches: Sequence[Stretch], floor: float, margins: Margins) -> list[Term]:
    """Hull and arm stay above the floor [m] wherever no task on altitude keeps the robot far from it."""
    if not np.isfinite(floor):
        return []
    rims, found = rims_of(scenario.robot), list[Term]()
    for stretch in stretches:
        phase = scenario.mission.phases[stretch.phase]
        on = active(phase, scenario.mission.hierarchy.tasks)
        if not any(isinstance(task, MinimumAltitude) and task.name not in stretch.waits_for for task in on):
            found.append(AboveFloor(rims=rims, height=floor + margins.altitude, phase=stretch.ocp.name))
    return found


def clearance_terms(scenario: Scenario, margins: Margins) -> tuple[Term, ...]:
    """The robot keeps away from obstacles, by as much as the mission's own tasks on clearance ask for."""
    if not scenario.environment.obstacles:
        return ()
    asked = [task.threshold for task in scenario.mission.hierarchy.tasks if isinstance(task, Clearance)]
    planned = coordinates(scenario.robot, reference=scenario.start)
    scene = collision_scene(planned, scenario.environment.obstacles, self_collision=False)
    kept = np.full(scene.n_pairs, max([margins.position, *asked]))
    return (ShapeClearance(scene=scene, margins=kept),) if scene.pairs else ()
