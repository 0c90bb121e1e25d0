"""Model of an identified vehicle: one step in time, with its derivatives.

The state is ``x = [q of the vehicle (7), its velocity in B (6), actuator outputs (n_u)]``. Joints
move as they were measured, and the vehicle's six rows of the inverse dynamics give its
acceleration. A command is held over the step; what actuators give follows it with a lag of first
order, exactly, and acts by its mean over the step: also a lag shorter than a step leaves its whole
impulse. The vehicle drifts for half a step, its velocity changes by the forces there, and it drifts
on: swings keep their period and their size better than by other rules of two evaluations.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.identification.coordinates import spatial_inertia
from uvms_ocp.identification.parameters import Unknowns
from uvms_ocp.identification.vehicle_declaration import ActuatorModel
from uvms_ocp.robot.spatial import cross, exp3, quaternion_to_matrix
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics, WaterCoefficients

N_Q = 7
N_V = 6
PAST = 12
PAST_STEP = 0.05
""", [s] of commands before a start: what actuators give there has a past."""
# of the dead zone, in which its edge is rounded where it is learnt, and where it is known
_EDGE = 0.2
_SHARP = 0.01


# The equations of motion of a vehicle whose quantities are expressions: those of the symbolic
# dynamics, nothing new.


def vehicle_dynamics(
    dynamics: SymbolicDynamics, values: Mapping[str, ca.SX], link: int = 0
) -> SymbolicDynamics:
    """Build the dynamics with the quantities of `vehicle_declaration` for the body that carries a
    link, and the water on it.
    """
    water = WaterCoefficients(
        added_mass=values["added_mass"],
        linear_drag=values["linear_drag"],
        quadratic_drag=values["quadratic_drag"],
        by_flow=dynamics.links[link].by_flow,
        displaced_mass=dynamics.density * values["volume"],
        p_LB=values["centre_of_buoyancy"],
    )
    inertia = spatial_inertia(values["mass"], values["centre_of_mass"], values["second_moment"])
    return dynamics.with_coefficients(rigid={dynamics.joint_of(link): inertia}, links={link: water})


# One step of an identified vehicle in time, with its derivatives.
#
# The state is ``x = [q of the vehicle (7), its velocity in B (6), what its actuators give (n_u)]``.
# Joints move as they were measured, and the vehicle's six rows of the inverse dynamics give its
# acceleration. A command is held over the step; what actuators give follows it with a lag of first
# order, exactly, and acts by its mean over the step: also a lag shorter than a step leaves its
# whole impulse. The vehicle drifts for half a step, its velocity changes by the forces there, and
# it drifts on: swings keep their period and their size better than by other rules of two
# evaluations.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Vehicle:
    """Symbolic dynamics, actuators and unknowns from which a stage is made."""

    dynamics: SymbolicDynamics
    shared: Unknowns
    """Unknowns of all recordings."""
    per_recording: Unknowns
    """Unknowns that each recording has for itself."""
    actuators: ActuatorModel
    link: int = 0
    """Index of the vehicle's link in ``dynamics.links``."""
    axes: tuple[int, ...] = tuple(range(N_V))
    """Places of the axes that it moves along; along the others it is held at rest."""

    @property
    def n_p(self) -> int:
        """Number of unknowns."""
        return len(self.shared.start) + len(self.per_recording.start)

    def values(self, p: ca.SX) -> dict[str, ca.SX]:
        """Return all quantities at the unknowns p (n_p,), the shared ones first."""
        n = len(self.shared.start)
        return self.shared.values(p[:n]) | self.per_recording.values(p[n:])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class StageFunctions:
    """CasADi functions of ``x (n_x,), u (n_u,), joints (3 n_j,), p (n_p,), h``, and of ``x, p``.

    u: commands of actuators. joints: position, velocity and acceleration of the joints, one under
    the other, in the middle of the step. p: unknowns, the shared ones first. h [s].
    """

    step: ca.Function
    """``x, u, joints, p, h -> x_next``"""
    slope: ca.Function
    """``x, u, joints, p, h -> A = dx_next/dx, B = dx_next/dp, C = dx_next/du``"""
    outputs: ca.Function
    """``x, p -> y (9,), dy/dx, dy/dp``: velocity where it is measured, in B; angular velocity and
    W's vertical, along the axes of the sensor of attitude.
    """
    begun: ca.Function
    """``u (n_u, PAST), p -> w, dw/dp, dw/du (n_u, n_u PAST)``: outputs w of actuators after
    commands of `PAST_STEP` each.
    """
    delays: ca.Function
    """``p -> d (2,), dd/dp`` [s] of commands, and of measured velocity."""
    n_x: int
    n_u: int
    n_j: int
    n_p: int


@checked
def stage_of(vehicle: Vehicle, *, sharp: bool = False) -> StageFunctions:
    """Build the functions of one step of a vehicle: motion, what sensors show, and slopes.

    sharp: dead zones that are known have sharp edges, which commands that are searched cannot have.
    """
    n_u = len(vehicle.actuators.names)
    n_j = vehicle.dynamics.model.nv - N_V
    x = ca.SX.sym("x", N_Q + N_V + n_u)
    u = ca.SX.sym("u", n_u)
    joints = ca.SX.sym("joints", 3 * n_j)
    p = ca.SX.sym("p", vehicle.n_p)
    h = ca.SX.sym("h")
    values = vehicle.values(p)
    zones = (
        vehicle.shared.declaration.quantities[name] for name in ("dead_zone", "dead_zone_reverse")
    )
    if sharp and not any(zone.free.any() for zone in zones):
        edge = _SHARP
    else:
        edge = _EDGE
    next_state = _after(vehicle, values, x, u, joints, h, edge)
    outputs = _outputs(values, x)
    past = ca.SX.sym("past", n_u, PAST)
    begun = _begun(vehicle, values, past, edge)
    delays = ca.vertcat(values["delay"], values["velocity_delay"])
    arguments = [x, u, joints, p, h]
    options = {"cse": True}
    return StageFunctions(
        step=ca.Function("step", arguments, [ca.densify(next_state)], options),
        slope=ca.Function(
            "slope",
            arguments,
            [ca.densify(ca.jacobian(next_state, variable)) for variable in (x, p, u)],
            options,
        ),
        outputs=ca.Function(
            "seen",
            [x, p],
            [
                ca.densify(outputs),
                *(ca.densify(ca.jacobian(outputs, variable)) for variable in (x, p)),
            ],
        ),
        begun=ca.Function(
            "begun",
            [past, p],
            [
                ca.densify(begun),
                *(ca.densify(ca.jacobian(begun, variable)) for variable in (p, past)),
            ],
        ),
        delays=ca.Function("delays", [p], [ca.densify(delays), ca.densify(ca.jacobian(delays, p))]),
        n_x=x.numel(),
        n_u=n_u,
        n_j=n_j,
        n_p=vehicle.n_p,
    )


def _after(
    vehicle: Vehicle,
    values: dict[str, ca.SX],
    x: ca.SX,
    u: ca.SX,
    joints: ca.SX,
    h: ca.SX,
    edge: float,
) -> ca.SX:
    integrate = vehicle.dynamics.symbolic.joints[0].kind.integrate
    q = x[:N_Q]
    thrust = x[N_Q + N_V :]
    moves = ca.DM(np.isin(np.arange(N_V), vehicle.axes).astype(float))
    nu = x[N_Q : N_Q + N_V] * moves
    target = _target(vehicle, values, u, edge)
    decay = ca.exp(-h / values["lag"])
    mean = target + (thrust - target) * (1 - decay) * values["lag"] / h
    middle = integrate(q, nu * h / 2)
    slope = _acceleration(vehicle, values, middle, nu, mean, joints)
    faster = nu + h * _acceleration(vehicle, values, middle, nu + h / 2 * slope, mean, joints)
    return ca.vertcat(integrate(middle, faster * h / 2), faster, target + (thrust - target) * decay)


def _target(vehicle: Vehicle, values: dict[str, ca.SX], u: ca.SX, edge: float) -> ca.SX:
    """Compute the steady thrust for commands u: next to nothing in the dead zone; beyond it all, or
    less by the zone's size.
    """
    beyond = _whole_beyond if vehicle.actuators.whole_beyond else _less_beyond
    forward = beyond(u, values["dead_zone"], edge)
    backward = beyond(-u, values["dead_zone_reverse"], edge)
    return values["gain"] * (forward - values["reverse"] * backward)


def _begun(vehicle: Vehicle, values: dict[str, ca.SX], past: ca.SX, edge: float) -> ca.SX:
    """Compute the thrust after the first command was held for long, and the others for a step
    each.
    """
    thrust = _target(vehicle, values, past[:, 0], edge)
    for k in range(1, PAST):
        target = _target(vehicle, values, past[:, k], edge)
        thrust = target + (thrust - target) * ca.exp(-PAST_STEP / values["lag"])
    return thrust


def _less_beyond(u: ca.SX, dead: ca.SX, edge: float) -> ca.SX:
    width = edge * dead
    return width * ca.log1p(ca.exp(-ca.fabs(u - dead) / width)) + ca.fmax(u - dead, 0)


def _whole_beyond(u: ca.SX, dead: ca.SX, edge: float) -> ca.SX:
    return u * (1 + ca.tanh((u - dead) / (2 * edge * dead))) / 2


def _acceleration(
    vehicle: Vehicle, values: dict[str, ca.SX], q: ca.SX, nu: ca.SX, thrust: ca.SX, joints: ca.SX
) -> ca.SX:
    dynamics = vehicle_dynamics(vehicle.dynamics, values, vehicle.link)
    n_j = joints.numel() // 3
    n_links = len(dynamics.links)
    all_q = ca.vertcat(q, joints[:n_j])
    all_v = ca.vertcat(nu, joints[n_j : 2 * n_j])
    joint_acceleration = ca.vertcat(ca.SX(N_V, 1), joints[2 * n_j :])
    water = ca.repmat(values["current"], 1, n_links), ca.SX(3, n_links)
    wrench = ca.DM(vehicle.actuators.wrench) @ thrust + values["bias"] + values["wrench_offset"]
    force = wrench - dynamics.inverse_dynamics(all_q, all_v, joint_acceleration, *water)[:N_V]
    axes = list(vehicle.axes)
    D, L_transposed, order = ca.ldl(dynamics.mass_matrix(all_q)[axes, axes], False)
    acceleration = ca.SX(N_V, 1)
    acceleration[axes] = ca.ldl_solve(force[axes], D, L_transposed, order)
    return acceleration


def _outputs(values: dict[str, ca.SX], x: ca.SX) -> ca.SX:
    linear = x[N_Q : N_Q + 3]
    angular = x[N_Q + 3 : N_Q + N_V]
    vertical = quaternion_to_matrix(x[3:N_Q])[2, :].T
    at_point = linear + cross(angular, values["velocity_point"])
    return ca.vertcat(
        at_point, as_measured(values, angular) + values["rate_bias"], as_measured(values, vertical)
    )


def as_measured(values: dict[str, ca.SX], vector: ca.SX) -> ca.SX:
    """Turn a vector (3,) [any] in B to the axes of the sensor of attitude."""
    return exp3(values["attitude_turn"] + values["attitude_offset"]).T @ vector
