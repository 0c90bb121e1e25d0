"""NED data and FLU data of one robot must be the same robot."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.robot.coefficients import links_in_water
from uvms_ocp.robot.description import RobotDescription, forward_left_up

S = np.diag([1.0, -1.0, -1.0])
THRUSTER = {"name": "t", "minimum": -1.0, "maximum": 1.0, "time_constant": 0.1}


def description(**entries: object) -> RobotDescription:
    return RobotDescription.model_validate({"convention": "NED", **entries})


def test_positions_and_directions_turn_about_x() -> None:
    turned = forward_left_up(
        description(
            thrusters=[{**THRUSTER, "position": (1.0, 2.0, 3.0), "direction": (0.0, 1.0, 1.0)}],
            trim=[{"name": "f", "position": (1.0, 2.0, 3.0), "mass": 1.0, "volume": 0.002}],
        )
    )
    assert turned.convention == "FLU"
    assert turned.thrusters[0].position == turned.trim[0].position == (1.0, -2.0, -3.0)
    assert turned.thrusters[0].direction == (0.0, -1.0, -1.0)


def test_flu_data_stay_as_they_are() -> None:
    same = RobotDescription.model_validate(
        {"trim": [{"name": "f", "position": (1, 2, 3), "mass": 1, "volume": 0}]}
    )
    assert forward_left_up(same) is same


@pytest.mark.parametrize(
    "shape", [{"cylinder": {"radius": 0.1, "length": 1.0}}, {"box": {"size": (1.0, 0.5, 0.2)}}]
)
def test_an_axis_given_in_ned_points_the_same_way_in_flu(
    shape: dict[str, dict[str, object]],
) -> None:
    ((kind, values),) = shape.items()
    rpy = (0.3, -0.4, 0.5)
    pose = {"position": (0.1, 0.2, 0.3), "rpy": rpy}
    (link,) = links_in_water(description(links={"a": {kind: {**values, "pose": pose}}}))
    R_ned = pin.rpy.rpyToMatrix(np.array(rpy))
    np.testing.assert_allclose(link.X_FL.rotation, S @ R_ned @ S, atol=1e-12)
    np.testing.assert_allclose(link.X_FL.translation, S @ [0.1, 0.2, 0.3])


def test_drag_power_does_not_depend_on_the_convention() -> None:
    rng = np.random.default_rng(2)
    root = rng.normal(size=(6, 6))
    water = {
        "linear_drag": (root @ root.T).tolist(),
        "pose": {"position": (0.1, 0.2, 0.3), "rpy": (0.1, 0.2, 0.3)},
    }
    (ned,) = links_in_water(description(convention="FLU", links={"a": {"coefficients": water}}))
    (flu,) = links_in_water(description(links={"a": {"coefficients": water}}))
    nu = rng.normal(size=6)
    turned = np.kron(np.eye(2), S) @ nu
    in_ned = ned.X_FL.inverse().action @ nu
    in_flu = flu.X_FL.inverse().action @ turned
    assert in_ned @ ned.linear_drag @ in_ned == pytest.approx(in_flu @ flu.linear_drag @ in_flu)
