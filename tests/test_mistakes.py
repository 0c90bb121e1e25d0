"""A user's mistakes raise the matching `UvmsError` with a message that says what is allowed."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.errors import FrameNotFound, InvalidInput, NameNotFound, UvmsError
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.scenario import pose_at


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"robot": "nautilus"}, NameNotFound, "unknown robot 'nautilus'"),
        ({"plant": "wet"}, NameNotFound, "unknown plant 'wet'"),
        (
            {"start": pose_at((8.0, 38.0, -45.0))},
            InvalidInput,
            "start position of the vehicle z = -45 m is below",
        ),
        (
            {"posture": [0, 0, 0, 1.0, 0, 0, 0]},
            InvalidInput,
            "joint 'joint4': given 1; allowed: -2.95 to 0.01",
        ),
        ({"posture": [0, 0, np.nan, 0, 0, 0, 0]}, InvalidInput, "joints has NaN"),
        ({"posture": [0, 0]}, InvalidInput, r"joints has shape \(2,\); allowed: \(7,\)"),
        ({"tasks": {"XX": {}}}, NameNotFound, "unknown task 'XX'"),
        (
            {"tasks": {"PC": {"gian": 1}}},
            NameNotFound,
            "unknown field of task PC 'gian'; known: name, task_class",
        ),
        (
            {"tasks": {"PC": {"gain_linear": 0}}},
            InvalidInput,
            "VehiclePose 'PC': gain_linear = 0; give a number > 0",
        ),
        (
            {"tasks": {"T": {"frame": "tol"}}},
            FrameNotFound,
            "unknown frame 'tol'.*Did you mean 'tool'",
        ),
        ({"order": ("T",)}, InvalidInput, "must name each of"),
        ({"seabed": float("nan")}, InvalidInput, "seabed = nan"),
        ({"dt": 0.0}, InvalidInput, "dt = 0.0 s"),
        (
            {"current": (0.1, 0.2)},
            InvalidInput,
            r"velocity of the current has shape \(2,\); allowed: \(3,\)",
        ),
        ({"target": (np.nan, 0, 0)}, InvalidInput, "target has NaN"),
    ],
)
def test_mistakes_in_a_scenario_are_named(
    options: dict[str, object], error: type[UvmsError], message: str
) -> None:
    with pytest.raises(error, match=message):
        case1(**options).controller()  # type: ignore[arg-type]


def test_a_zero_quaternion_is_refused() -> None:
    robot = case1().robot
    with pytest.raises(InvalidInput, match="quaternion has norm 0"):
        robot.configuration(quaternion=[0.0, 0.0, 0.0, 0.0])


def test_a_robot_without_altimeter_is_refused_by_name() -> None:
    with pytest.raises(FrameNotFound, match="unknown frame 'sonar'"):
        case1().robot.with_frame_pose("sonar", pin.SE3.Identity())


def test_every_error_is_one_line() -> None:
    with pytest.raises(UvmsError) as caught:
        case1(robot="nautilus")
    assert "\n" not in str(caught.value)
