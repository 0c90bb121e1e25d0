"""What surrounds a mission, as an optimal control problem takes it: one current, a level floor, obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from uvms_ocp.arrays import Mask
from uvms_ocp.collision.collision_scene import CollisionScene, collision_scene
from uvms_ocp.collision.conservative_advancement import ClearanceReport
from uvms_ocp.collision.coordinates import coordinates
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.mission_plan.above_floor import AboveFloor, rims_of
from uvms_ocp.mission_plan.greedy_way import GreedyWay
from uvms_ocp.mission_plan.kept_tasks import active
from uvms_ocp.mission_plan.margins import Margins
from uvms_ocp.mission_plan.stretches import Stretch
from uvms_ocp.ocp.clearance.certificate import SteppedMotion, certificate, shortfall
from uvms_ocp.ocp.clearance.shape_clearance import ShapeClearance
from uvms_ocp.ocp.terms import Term
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.scenario import Scenario
from uvms_ocp.tasks.altitude import MinimumAltitude
from uvms_ocp.tasks.clearance import Clearance

_LEVEL = 0.05  # [m] by which a floor may differ along the way
_MISSED = 2e-3  # [m] of a margin
_NEAR = 0.01  # [m] beyond its margin, within which a pair gets rows
_PAIR_ROWS = 4  # per node and pair of links


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


def clearance(scenario: Scenario, margins: Margins) -> ShapeClearance | None:
    """The robot keeps away from obstacles, by as much as the mission's own tasks on clearance ask for, and from itself.

    Links that are near each other by design keep half of what they have at rest, and at the start what they have there.
    """
    planned = coordinates(scenario.robot, reference=scenario.start)
    scene = collision_scene(planned, scenario.environment.obstacles)
    asked = [task.threshold for task in scenario.mission.hierarchy.tasks if isinstance(task, Clearance)]
    kept = np.where(_links(scene), np.minimum(margins.links, scene.room), max([margins.position, *asked]))
    return ShapeClearance(scene=scene, margins=kept) if scene.pairs else None


def _links(scene: CollisionScene) -> Mask:
    """(n_pairs,) True for two of them."""
    return np.isfinite(scene.room)


def of_obstacles(shapes: ShapeClearance) -> ShapeClearance:
    """Of these pairs those with obstacles."""
    return _among(shapes, ~_links(shapes.scene))


def of_links(shapes: ShapeClearance, pairs: Mask) -> ShapeClearance:
    """Of these pairs the chosen (n_pairs,) of links, with rows of their own."""
    return replace(_among(shapes, pairs), n_pair_rows=_PAIR_ROWS)


def _among(shapes: ShapeClearance, pairs: Mask) -> ShapeClearance:
    return replace(shapes, scene=shapes.scene.among(np.flatnonzero(pairs).tolist()), margins=shapes.margins[pairs])


def missed_links(shapes: ShapeClearance, way: Trajectory) -> Mask:
    """(n_pairs,) True for links that do not keep their margins along a way, at its nodes and between them."""
    return (shortfall(shapes, way, 0.0).max(axis=0) > _MISSED) & _links(shapes.scene)


def near_links(shapes: ShapeClearance, way: Trajectory) -> Mask:
    """(n_pairs,) True for links that nearly do not."""
    return missed_links(replace(shapes, margins=shapes.margins + _NEAR), way)


def proof_along(shapes: ShapeClearance, way: Trajectory) -> ClearanceReport:
    """The certificate that all pairs stay apart along a way, with the least distance that is met, at its nodes too."""
    report = certificate(shapes, way)
    sampled = SteppedMotion(term=shapes, trajectory=way).nearest()
    return replace(report, nearest=min(report.nearest, sampled, key=lambda nearest: nearest.distance))
