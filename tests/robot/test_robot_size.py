"""Weight and size are units: a robot whose model has no gravity has them, too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from uvms_ocp.ocp.problem import Actuation
from uvms_ocp.ocp.transcription.actuation import ActuationModel
from uvms_ocp.robot import load_robot, size


def test_weight_and_size_are_those_of_the_mass() -> None:
    robot = load_robot("girona_maris7")
    total = sum(inertia.mass for inertia in robot.model.inertias[1:])
    np.testing.assert_allclose(size.weight(robot.model), 9.81 * total, rtol=1e-12)
    np.testing.assert_allclose(size.size(robot.model) ** 3, total / 1000.0, rtol=1e-12)


def test_units_of_actuators_stay_without_gravity() -> None:
    robot = load_robot("girona_maris7")
    model = pin.Model(robot.model)
    model.gravity = pin.Motion.Zero()
    units = ActuationModel(robot, Actuation.WRENCH)
    weightless = ActuationModel(replace(robot, model=model), Actuation.WRENCH)
    assert np.all(weightless.thrust_unit > 0)
    np.testing.assert_array_equal(weightless.thrust_unit, units.thrust_unit)
    np.testing.assert_array_equal(weightless.force_unit, units.force_unit)
