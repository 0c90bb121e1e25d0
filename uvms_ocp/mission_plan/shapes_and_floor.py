"""What surrounds a mission, as an optimal control problem takes it: one current, a level floor, obstacles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uvms_ocp.collision.collision_scene import Nearest, collision_scene
from uvms_ocp.collision.coordinates import coordinates
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.mission_plan.above_floor import AboveFloor, rims_of
from uvms_ocp.mission_plan.greedy_way import GreedyWay
from uvms_ocp.mission_plan.kept_tasks import active
from uvms_ocp.mission_plan.margins import Margins
from uvms_ocp.mission_plan.stretches import Stretch
from uvms_ocp.ocp.clearance.certificate import SteppedMotion, shortfall
from uvms_ocp.ocp.clearance.shape_clearance import ShapeClearance
from uvms_ocp.ocp.terms import Term
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.scenario import Scenario
from uvms_ocp.tasks.altitude import MinimumAltitude
from uvms_ocp.tasks.clearance import Clearance

_LEVEL = 0.05  # [m] by which a floor may differ along the way
_MISSED = 2e-3  # [m] of a margin
_OWN_ROWS = 6  # per node


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


def clearance_terms(scenario: Scenario, margins: Margins) -> tuple[ShapeClearance, ...]:
    """The robot keeps away from obstacles, by as much as the mission's own tasks on clearance ask for, and from itself.

    Links that are near each other by design keep half of what they have at rest, and at the start what they have there.
    """
    planned = coordinates(scenario.robot, reference=scenario.start)
    scene = collision_scene(planned, scenario.environment.obstacles)
    asked = [task.threshold for task in scenario.mission.hierarchy.tasks if isinstance(task, Clearance)]
    of_links = np.isfinite(scene.room)
    kept = np.where(of_links, np.minimum(margins.links, scene.room), max([margins.position, *asked]))
    return (ShapeClearance(scene=scene, margins=kept, n_own_rows=_OWN_ROWS),) if scene.pairs else ()


def is_apart(shapes: Sequence[ShapeClearance], way: Trajectory) -> bool:
    """Whether all pairs keep their margins along a way, at its nodes and between them."""
    return all(shortfall(term, way, 0.0).max(initial=0.0) <= _MISSED for term in shapes)


def nearest_along(shapes: Sequence[ShapeClearance], way: Trajectory) -> Nearest | None:
    """The least distance of any pair along a way, between its nodes too; `None` where there are no pairs."""
    found = [SteppedMotion(term=term, trajectory=way).nearest() for term in shapes]
    return min(found, key=lambda nearest: nearest.distance, default=None)
