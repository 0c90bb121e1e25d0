"""What a load at the tool, and a current, add to the generalized force that an observer takes for a disturbance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import casadi as ca

from uvms_ocp.control.load.learning import LOAD_FRAME
from uvms_ocp.model.symbolic.dynamics import SymbolicDynamics
from uvms_ocp.model.symbolic.joint_types import sparse

_LEAST_FLOW = (
    0.1  # [m/s] of drag's slope: that of quadratic drag vanishes in still water, where no step would be the right one
)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Response:
    """Of an observer to k forces, each as if it were the only disturbance."""

    estimate: ca.SX
    """(n_v, k) [N, N m] of its estimate."""
    innovation: ca.SX
    """(n_v, k) [m/s, rad/s] of its innovation."""


class Follower(Protocol):
    """What is asked of an observer's law."""

    def response(self, before: Response, M: ca.SX, force: ca.SX, share: ca.SX) -> Response:
        """A tick later, under forces (n_v, k) [N, N m], with the mass matrix M and a share (n_v,) [-] of the bandwidth."""


def load_force(body: SymbolicDynamics, q: ca.SX, acceleration: ca.SX) -> ca.SX:
    """Generalized force (n_v, 2) of 1 N of net weight, and of 1 kg, at q (n_q,) [m, rad].

    acceleration (3,) [m/s2] of the tool in W. A point load of mass m and volume V gives ``J.T (W down - m a)`` with
    the net weight ``W = (m - rho V) g``: what it has of its mass alone shows only where the tool accelerates.
    """
    J = body.symbolic.forward_kinematics(q).jacobian(LOAD_FRAME)[:3, :]
    gravity = sparse(body.model.gravity.linear)
    return ca.horzcat(J.T @ (gravity / ca.norm_2(gravity)), -J.T @ acceleration)


def current_force(body: SymbolicDynamics, q: ca.SX, v: ca.SX, current: ca.SX) -> ca.SX:
    """Generalized force (n_v, 4) of the currents u near `current` (3,) [m/s] in W: the first column plus the others times u.

    At q (n_q,) [m, rad] and v (n_v,) [m/s, rad/s].
    """
    n, still = len(body.links), ca.SX(3, len(body.links))
    flow = ca.SX.sym("flow", 3)
    drag = body.bias_force(q, v, still, still) - body.bias_force(q, v, ca.repmat(flow, 1, n), still)
    quicker = current + ca.if_else(current < 0, -_LEAST_FLOW, _LEAST_FLOW)
    slopes = ca.substitute(ca.jacobian(drag, flow), flow, quicker)
    return ca.horzcat(ca.substitute(drag, flow, current) - slopes @ current, slopes)


def tool_function(body: SymbolicDynamics) -> ca.Function:
    """Function ``q, v -> weight, velocity``: `load_force` of 1 N, and the velocity (3,) [m/s] of the tool in W."""
    q, v = ca.SX.sym("q", body.model.nq), ca.SX.sym("v", body.model.nv)
    velocity = body.symbolic.forward_kinematics(q).jacobian(LOAD_FRAME)[:3, :] @ v
    weight = load_force(body, q, ca.SX(3, 1))[:, 0]
    return ca.Function("tool", [q, v], [ca.densify(weight), velocity], ["q", "v"], ["weight", "velocity"])


def response_function(body: SymbolicDynamics, law: Follower) -> ca.Function:
    """Function ``q, v, acceleration, current, share, estimate, innovation -> estimate, innovation``.

    The response of the observer to what is put into its estimate and bears no force, to `load_force` and to `current_force`.
    """
    n, symbol = body.model.nv, ca.SX.sym
    x = {"q": symbol("q", body.model.nq), "v": symbol("v", n), "acceleration": symbol("acceleration", 3)}
    x |= {"current": symbol("current", 3), "share": symbol("share", n)}
    before = Response(estimate=symbol("estimate", n, COLUMNS), innovation=symbol("innovation", n, COLUMNS))
    drag = current_force(body, x["q"], x["v"], x["current"])
    force = ca.horzcat(ca.SX(n, 1), load_force(body, x["q"], x["acceleration"]), drag)
    after = law.response(before, body.mass_matrix(x["q"]), force, x["share"])
    outputs = ca.cse([ca.densify(after.estimate), ca.densify(after.innovation)])
    return ca.Function("response", [*x.values(), before.estimate, before.innovation], outputs)


COLUMNS = 7
"""[-] of `response_function`."""
