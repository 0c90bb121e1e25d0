"""The lowest point of every shape, against the support of the shape itself."""

from __future__ import annotations

import casadi as ca
import coal
import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.mission_plan.clearances import FloorClearance, rims_of
from uvms_ocp.ocp.problem import OcpLevel, single_phase
from uvms_ocp.ocp.terms import Effort
from uvms_ocp.ocp.transcription.stage import StageModel
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.hull import skid_points
from uvms_ocp.robot.signals import State


@pytest.mark.parametrize("seed", range(4))
def test_the_lowest_row_is_the_distance_of_the_arm_from_a_plane(seed: int) -> None:
    robot = load_robot("girona_maris7_full")
    rng = np.random.default_rng(seed)
    lower = robot.limits.position_lower
    upper = robot.limits.position_upper
    q = robot.configuration(
        position=(0, 0, 5.0), rpy=rng.uniform(-0.3, 0.3, 3), joints=rng.uniform(lower, upper)
    )
    rims = rims_of(robot)
    rows = heights(robot, q, FloorClearance(rims=rims, height=0.0))
    arm = [row for row, rim in zip(rows, rims, strict=True) if rim.joint > 1]
    assert min(arm) == pytest.approx(distance_of_arm(robot, q), abs=1e-4)
    X_WB = pin.XYZQUATToSE3(q[:7])
    hull = [row for row, rim in zip(rows, rims, strict=True) if rim.joint == 1]
    np.testing.assert_allclose(
        hull, [X_WB.act(point)[2] for point in skid_points(robot)], atol=1e-3
    )


def heights(robot: Robot, q: np.ndarray, term: FloorClearance) -> np.ndarray:
    """Rows (m,) [m] of the term at q (n_q,)."""
    start = State(q=q, v=np.zeros(robot.n_v))
    level = OcpLevel(name="effort", terms=(Effort(),))
    model = StageModel(
        single_phase(robot=robot, start=start, duration=1.0, n_steps=1, levels=[level])
    )
    rows = term.residual(model.symbols, ca.SX(0, 1)).value
    z = np.zeros(model.layout.n_z)
    z[model.layout.q] = q
    return np.array(ca.Function("rows", [model.z], [rows])(z)).ravel()


def distance_of_arm(robot: Robot, q: np.ndarray) -> float:
    """[m] from the plane z = 0, by coal."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    arm = [shape for shape in robot.collision_model.geometryObjects if shape.parentJoint > 1]
    return min(
        distance(shape.geometry, data.oMi[shape.parentJoint] * shape.placement) for shape in arm
    )


def distance(geometry: coal.CollisionGeometry, X: pin.SE3) -> float:
    """[m] of a shape at X from the plane z = 0."""
    floor = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
    request = coal.DistanceRequest()
    result = coal.DistanceResult()
    place = coal.Transform3s(X.rotation, X.translation)
    return float(
        coal.distance(geometry, place, floor, coal.Transform3s.Identity(), request, result)
    )
