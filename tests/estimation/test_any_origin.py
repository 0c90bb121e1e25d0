"""Where the origin of the world lies, and where north is, changes no estimate: it is the same in
the other world.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import uvms_ocp as uo
from uvms_ocp.estimation.estimator import Estimator, PassThrough
from uvms_ocp.robot.signals import IDEAL_SENSORS, Readings, SensorSpecs, State
from uvms_ocp.scenario.cases import reach
from uvms_ocp.sim import SensorSuite

DT = 0.02
TICKS = 300
FLOOR = uo.FlatSeafloor(z=-40.0)
WORLDS = {  # X_NW of the new world N
    "moved by 1 km": pin.SE3(np.eye(3), np.array([800.0, -600.0, 0.0])),
    "turned": pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 2.5), np.array([-600.0, 800.0, 0.0])),
    "half turned": pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, np.pi), np.zeros(3)),
    "turned once around": pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 2 * np.pi), np.zeros(3)),
}


def moved(X_NW: pin.SE3, readings: Readings, sign: float) -> Readings:
    """What sensors of the same errors read there, with either of the two quaternions of an
    attitude.
    """
    moved_readings = {}
    place = readings.position
    if place is not None:
        moved_readings["position"] = replace(place, value=X_NW.act(np.asarray(place.value)))
    attitude = readings.attitude
    if attitude is not None:
        turned = pin.Quaternion(X_NW.rotation) * pin.Quaternion(np.array(attitude.value))
        moved_readings["attitude"] = replace(attitude, value=sign * turned.coeffs())
    return replace(readings, **moved_readings)


def recorded(robot: uo.Robot, specs: SensorSpecs) -> list[Readings]:
    """Of a vehicle that sways while it turns by more than a turn, and of its arm."""
    suite = SensorSuite(robot, FLOOR, specs, seed=3)
    q = robot.configuration(position=(1.0, 2.0, -36.0), rpy=(0.1, -0.05, 0.5))
    rows = []
    amplitude = np.array([0.4, 0.3, 0.2, 0.1, 0.1, 0.0] + [0.2] * robot.n_joints)
    for k in range(TICKS):
        v = amplitude * np.sin(np.linspace(0.6, 1.2, robot.n_v) * k * DT)
        v[5] = 1.2
        rows.append(suite.read(State(q=q, v=v, a=np.zeros(robot.n_v)), k * DT))
        q = pin.integrate(robot.model, q, v * DT)
    return rows


ESTIMATORS = {
    "filter": (SensorSpecs(), lambda robot: Estimator(robot, SensorSpecs())),
    "filter with health": (
        SensorSpecs(),
        lambda robot: reach(robot=robot, noise=True, dt=DT).estimator(),
    ),
    "ideal": (IDEAL_SENSORS, lambda robot: Estimator(robot, IDEAL_SENSORS)),
    "none": (IDEAL_SENSORS, PassThrough),
}


@pytest.mark.sampled
@pytest.mark.parametrize("kind", ESTIMATORS)
def test_an_estimate_is_the_same_in_any_world(kind: str) -> None:
    robot = uo.load_robot("bluerov2_alpha5")
    specs, build = ESTIMATORS[kind]
    readings = recorded(robot, specs)
    estimator = build(robot)
    usual = [estimator(row, k * DT) for k, row in enumerate(readings)]
    for name, X_NW in WORLDS.items():
        moved_estimator = build(robot)
        for k, row in enumerate(readings):
            estimate = moved_estimator(moved(X_NW, row, -1.0 if k // 40 % 2 else 1.0), k * DT)
            pose = X_NW.inverse() * pin.XYZQUATToSE3(estimate.q[:7])
            apart = pin.log6(pin.XYZQUATToSE3(usual[k].q[:7]).inverse() * pose).vector
            assert np.abs(apart).max() < 1e-6, (name, k)
            np.testing.assert_allclose(estimate.q[7:], usual[k].q[7:], atol=1e-7, err_msg=name)
            np.testing.assert_allclose(estimate.v, usual[k].v, atol=1e-6, err_msg=name)
            np.testing.assert_allclose(
                estimate.altimeter_range, usual[k].altimeter_range, atol=1e-6, err_msg=name
            )
            assert estimate.age == usual[k].age
