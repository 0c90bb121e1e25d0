"""A planned motion of either method, and what its report and its record tell alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.arrays import Array
from uvms_ocp.collision.collision_scene import CollisionScene, Nearest
from uvms_ocp.meta_values import AxisLimitsMeta, ClearanceMeta, FrameMeta, PhaseMeta, SurroundingsMeta
from uvms_ocp.model.kinematics import Kinematics
from uvms_ocp.ocp.request import OcpRequest
from uvms_ocp.planning.goals import ToolGoal
from uvms_ocp.planning.request import PlanRequest
from uvms_ocp.run_meta import PlanMeta, packages

_TOOL = "tool"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Motion:
    """Samples of a planned motion, both ends included, and the distances at them."""

    request: PlanRequest | OcpRequest
    scene: CollisionScene
    t: Array
    """(n,) [s]"""
    q: Array
    """(n, n_q) [m, rad] configurations."""
    distances: Array
    """(n, n_pairs) [m] of all pairs of shapes."""

    @property
    def nearest(self) -> Nearest:
        """The smallest distance at any sample."""
        return self.scene.nearest(self.t, self.distances)

    def goal_pose(self) -> pin.SE3 | None:
        """X_WF at the end, of the frame that has a goal, else of the tool; `None` without such a frame."""
        robot, goal = self.request.robot, self.request.goal
        frame = goal.frame if isinstance(goal, ToolGoal) else _TOOL
        return Kinematics(robot, self.q[-1]).pose(frame) if robot.has_frame(frame) else None

    def tool_error(self) -> dict[str, float] | None:
        """Distance [m] and angle [rad] of the frame from its goal at the end; `None` for the goal of a posture."""
        goal, X_WF = self.request.goal, self.goal_pose()
        if X_WF is None or not isinstance(goal, ToolGoal):
            return None
        target = goal.target
        if not isinstance(target, pin.SE3):
            return {"position_m": float(np.linalg.norm(X_WF.translation - target))}
        return {
            "position_m": float(np.linalg.norm(X_WF.translation - target.translation)),
            "orientation_rad": float(np.linalg.norm(pin.log3(X_WF.rotation.T @ target.rotation))),
        }

    def clearance_series(self) -> dict[str, Array]:
        """``clearance`` (n, n_groups) [m] and ``quantities`` (n, 1) [m] of a record; none where nothing can meet."""
        d, groups = self.distances, self.scene.groups()
        if not groups:
            return {}
        smallest = [d[:, pairs].min(axis=1) for pairs in groups.values()]
        return {"clearance": np.stack(smallest, axis=1), "quantities": d.min(axis=1)[:, None]}


def nearest_entries(nearest: Nearest | None) -> dict[str, Any]:
    """The smallest distance in a report; `None` where there is no motion to measure, or nothing can meet."""
    if nearest is None:
        return dict.fromkeys(("min_clearance_m", "min_clearance_at_s", "min_clearance_between"))
    return {
        "min_clearance_m": nearest.distance if np.isfinite(nearest.distance) else None,
        "min_clearance_at_s": nearest.time,
        "min_clearance_between": nearest.pair,
    }


def plan_meta(
    motion: Motion, *, scenario: str, axis_limits: AxisLimitsMeta, breaks: tuple[float, ...], nearest: Nearest
) -> PlanMeta:
    """What a record tells of a plan.

    breaks [s] are where the pieces of its trajectory meet; `nearest` is the smallest distance that the method met.
    """
    request, scene, X_WF = motion.request, motion.scene, motion.goal_pose()
    return PlanMeta(
        scenario=scenario,
        robot=request.robot.name,
        joints=request.robot.joint_names,
        phases=(PhaseMeta(name="plan"),),
        quantities=("plan.clearance",) if scene.n_pairs else (),
        surroundings=SurroundingsMeta(
            frames=() if X_WF is None else (FrameMeta(name="goal", pose=tuple(pin.SE3ToXYZQUAT(X_WF).tolist())),),
            obstacles=request.obstacles,
        ),
        packages=packages(),
        axes=scene.coordinates.names,
        axis_limits=axis_limits,
        breaks=breaks,
        clearance_wanted=request.clearance,
        clearance_groups=tuple(scene.groups()),
        min_clearance=_clearance(nearest) if scene.n_pairs else None,
    )


def _clearance(nearest: Nearest) -> ClearanceMeta:
    return ClearanceMeta(t=nearest.time, distance=nearest.distance, between=nearest.pair)
