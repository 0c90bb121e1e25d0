"""Measurements of a user's own channels, as the filter compares them: predicted, with their derivatives
with respect to its errors by CasADi.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation.filter_memory import MAIN, N_CHANNELS, Part
from uvms_ocp.robot import spatial
from uvms_ocp.robot.channels import LARGEST_OWN, Channel
from uvms_ocp.robot.measurement import measured
from uvms_ocp.robot.robot import Robot

_RATES = (
    (Part.TURN, Part.SPIN),
    (Part.PLACE, Part.SPEED),
    (Part.SPEED, Part.ACCELERATION),
    (Part.SPIN, Part.SPIN_UP),
)
"""Parts of the state that channels of one's own depend on, each with the part that is its rate."""


def require_fusible(robot: Robot, own: tuple[Channel, ...]) -> None:
    """Raise `InvalidInput` for channels of a robot whose filter cannot fuse them."""
    if not own:
        return
    if not robot.n_vehicle:
        raise InvalidInput(
            f"channel {own[0].name} of a robot on a fixed base, whose filter knows its joints alone;"
            " load it with base='free_flyer', or leave the channel out"
        )
    if any(joint.n_q != joint.n_v for joint in robot.joints):
        raise InvalidInput(
            f"channel {own[0].name} of a robot with joints that turn without end, or of several axes;"
            " give these limits, or leave the channel out"
        )


@lru_cache(maxsize=16)
def own_measurements(robot: Robot, own: tuple[Channel, ...]) -> ca.Function:
    """Build the function of the filter's state: attitude (4,), state (MAIN,), positions and rates of
    the joints (2 n_joints,).

    It gives, of `LARGEST_OWN` rows for each channel: predicted measurements, their derivatives with
    respect to the errors of the vehicle's state, row by row, their rates, and their derivatives
    with respect to the positions of the joints, row by row. Raises `InvalidInput` as
    `uvms_ocp.robot.measurement.measured`.
    """
    n_joints = robot.n_joints
    turn = ca.SX.sym("turn", 4)
    x = ca.SX.sym("x", MAIN)
    joints = ca.SX.sym("joints", 2 * n_joints)
    error = ca.SX.sym("error", MAIN)
    joint_error = ca.SX.sym("joint_error", n_joints)
    true_turn = spatial.quaternion_multiply(turn, spatial.quaternion_exp(error[:3]))
    R_WB = spatial.quaternion_to_matrix(true_turn)
    true = x + error
    place = true[Part.PLACE : Part.PLACE + 3]
    speed = true[Part.SPEED : Part.SPEED + 3]
    spin = true[Part.SPIN : Part.SPIN + 3]
    q = ca.vertcat(place, true_turn, joints[:n_joints] + joint_error)
    v = ca.vertcat(R_WB.T @ speed, spin, joints[n_joints:])
    h = measured(robot, own, q, v)
    H = ca.jacobian(h, error)
    joint_H = ca.jacobian(h, joint_error)
    rate = joint_H @ joints[n_joints:]
    for part, rate_part in _RATES:
        rate += H[:, part : part + 3] @ x[rate_part : rate_part + 3]
    zero = [ca.SX.zeros(MAIN), ca.SX.zeros(n_joints)]
    outputs = ca.substitute([h, ca.vec(H.T), rate, ca.vec(joint_H.T)], [error, joint_error], zero)
    return ca.Function(
        "measure_own", [turn, x, joints], [ca.densify(output) for output in outputs], {"cse": True}
    )


def write_dependence(memory: Any, robot: Robot, own: tuple[Channel, ...]) -> None:
    """Write what each channel of one's own depends on into the arrays of a `FilterMemory`: on a
    velocity, which is one integration from an acceleration, and on which coordinates in W.
    """
    if not own:
        return
    q = ca.SX.sym("q", robot.n_q)
    v = ca.SX.sym("v", robot.n_v)
    h = measured(robot, own, q, v)
    depends_on_q = _dependence(h, q)
    depends_on_v = _dependence(h, v)
    for k in range(len(own)):
        rows = slice(LARGEST_OWN * k, LARGEST_OWN * (k + 1))
        memory.orders[N_CHANNELS + k] = 1 if depends_on_v[rows].any() else 2
        memory.of_place[N_CHANNELS + k] = depends_on_q[rows, :3].any(axis=0)


def _dependence(values: ca.SX, of: ca.SX) -> np.ndarray:
    """Return (n_values, n_of) True where a value depends on an entry."""
    return np.array(ca.DM(ca.jacobian(values, of).sparsity(), 1.0).full(), dtype=bool)
