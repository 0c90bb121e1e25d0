"""Measurement functions of a user's own channels, as CasADi expressions of configuration and
velocity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.channels import LARGEST_OWN, Channel
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.symbolic_model import SymbolicKinematics, SymbolicModel


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MeasuredState:
    """State that a channel measures, as CasADi expressions."""

    q: ca.SX
    """Configuration (n_q,) [m, rad]."""
    v: ca.SX
    """Velocity (n_v,) [m/s, rad/s], vehicle part in B."""
    kinematics: SymbolicKinematics
    """Poses and Jacobians of all frames at q."""

    def pose(self, frame: str) -> tuple[ca.SX, ca.SX]:
        """Return the pose X_WF of a frame: R_WF (3, 3) and p_WF (3,) [m]. Raises FrameNotFound."""
        return self.kinematics.pose(frame)

    def velocity(self, frame: str) -> ca.SX:
        """Return the velocity (6,) [m/s, rad/s] of a frame at its origin, in W, linear part first.
        Raises FrameNotFound.
        """
        return self.kinematics.jacobian(frame) @ self.v


def measured(robot: Robot, own: Sequence[Channel], q: ca.SX, v: ca.SX) -> ca.SX:
    """Return what channels measure at q (n_q,) and v (n_v,): `LARGEST_OWN` numbers of each, of which
    those that it has not are 0.

    Raises `InvalidInput` for a measurement function that returns anything but an expression of the
    size of its channel.
    """
    if not own:
        return ca.SX(0, 1)
    model = SymbolicModel(robot.model)
    state = MeasuredState(q=q, v=v, kinematics=model.forward_kinematics(q))
    values = list[ca.SX]()
    for channel in own:
        assert channel.measure is not None
        value = channel.measure(state)
        shape = getattr(value, "shape", ())
        if not isinstance(value, ca.SX) or shape != (channel.size, 1):
            what = type(value).__name__ + (f" of shape {shape}" if shape else "")
            raise InvalidInput(
                f"measure of channel {channel.name} returned {what}; return a CasADi expression of"
                f" its state, of shape ({channel.size}, 1)"
            )
        values += [value, ca.SX.zeros(LARGEST_OWN - channel.size)]
    return ca.densify(ca.vertcat(*values))


@lru_cache(maxsize=16)
def measurement_function(robot: Robot, own: tuple[Channel, ...]) -> ca.Function:
    """Build the function of q (n_q,) and v (n_v,) that gives what channels measure."""
    q = ca.SX.sym("q", robot.n_q)
    v = ca.SX.sym("v", robot.n_v)
    return ca.Function("measure", [q, v], [measured(robot, own, q, v)], {"cse": True})
