"""A joint without end, in a plane or without range changes no task: it asks of the others what it
asks of the twin's.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from odd_robots import ODD, pair_of
from task_registry import REGISTRY
from task_values import evaluate

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.tasks import Manipulability


@pytest.mark.parametrize("kind", ODD)
@pytest.mark.parametrize("name", REGISTRY)
def test_a_task_asks_the_same_of_a_robot_with_an_odd_joint_and_of_its_twin(
    name: str, kind: str
) -> None:
    pair = pair_of(kind)
    task = REGISTRY[name].task
    rng = np.random.default_rng(5)
    task = replace(task, joints=("turn0", "turn2")) if name == "MP" else task
    for _ in range(3):
        moved = rng.uniform(-0.9, 0.9, pair.odd.n_v)
        moved[7] *= kind != "zero range"
        q = pin.integrate(pair.odd.model, pair.odd.configuration(position=(0.0, 0.0, -5.0)), moved)
        quantities = evaluate(pair.odd, task, q)
        expected = evaluate(pair.twin, task, pair.of_twin(q))
        quantities["jacobian"] = (
            quantities["jacobian"] @ pair.velocities(q).T
        )  # what the twin's motions change
        for quantity, values in quantities.items():
            rows = (
                [0, -1] if name == "JL" and len(values) > 1 else slice(None)
            )  # of the joints that both have limits of
            np.testing.assert_allclose(
                values[rows], expected[quantity][rows], rtol=0, atol=1e-9, err_msg=quantity
            )


@pytest.mark.parametrize("tool", ["port_tool", "starboard_tool"])
def test_manipulability_is_that_of_the_arm_that_moves_its_frame(tool: str) -> None:
    """Joints of another arm add rows of zeros and nothing else."""
    two = load_robot("bluerov2_two_alpha5")
    one_arm = load_robot("bluerov2_alpha5")
    arm = [0.3, 0.4, 0.5, 0.6]
    rows = evaluate(two, Manipulability(frame=tool), two.configuration(joints=[*arm, *arm]))
    expected = evaluate(one_arm, Manipulability(), one_arm.configuration(joints=arm))
    assert rows["manipulability"] == pytest.approx(expected["manipulability"])
    columns = [two.joint(f"{tool.removesuffix('tool')}joint{k}").idx_v for k in range(1, 5)]
    np.testing.assert_allclose(
        rows["jacobian"][:, columns], expected["jacobian"][:, one_arm.joint_v], atol=1e-12
    )


@pytest.mark.parametrize("name", ["bluerov2_alpha5", "bluerov2"])
def test_manipulability_of_a_frame_that_no_joint_moves_is_refused(name: str) -> None:
    """That of no joints at all would be 1, the best there is, of a frame that was mistaken for the
    tool.
    """
    robot = load_robot(name)
    with pytest.raises(
        InvalidInput,
        match="manipulability of 'base_link': no joint with a range moves it; give one on an arm",
    ):
        evaluate(robot, Manipulability(frame="base_link"), robot.configuration())
