"""Model of an identified vehicle: one step in time, with its derivatives.

The state is ``x = [q of the vehicle (7), its velocity in B (6), actuator outputs (n_u)]``. Joints
move as they were measured, and the vehicle's six rows of the inverse dynamics give its
acceleration. A command is held over the step; what actuators give follows it with a lag of first
order, exactly, and acts by its mean over the step, so that the impulse is right even where the lag
is shorter than a step. The vehicle drifts for half a step, its velocity changes by the forces
there, and it drifts on (leapfrog): periods and amplitudes of swings are kept better than by other
rules of two evaluations.
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
"""Number of coordinates of the vehicle's pose: position and quaternion."""
N_V = 6
"""Number of the vehicle's velocities: linear and angular."""
PAST = 12
"""Number of commands before a start from which the outputs of actuators there are computed."""
PAST_STEP = 0.05
"""[s] time for which each of the `PAST` commands is held."""
_LEARNT_EDGE = 0.2  # share of a dead zone in which its edge is rounded, if the zone is learnt
_KNOWN_EDGE = 0.01  # share of a dead zone in which its edge is rounded, if the zone is known


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Vehicle:
    """Symbolic dynamics, actuators and unknowns from which a stage is made."""

    dynamics: SymbolicDynamics
    """Dynamics of vehicle and arm, whose coefficients the quantities replace."""
    shared: Unknowns
    """Unknowns of all recordings."""
    per_recording: Unknowns
    """Unknowns that each recording has for itself."""
    actuators: ActuatorModel
    """Actuators that push it, and how recordings command them."""
    link: int = 0
    """Index of the vehicle's link in ``dynamics.links``."""
    axes: tuple[int, ...] = tuple(range(N_V))
    """Indices of the axes along which it moves; along the others it is held at rest."""

    @property
    def n_p(self) -> int:
        """Number of unknowns."""
        return len(self.shared.start) + len(self.per_recording.start)

    def values(self, p: ca.SX) -> dict[str, ca.SX]:
        """Return all quantities at the unknowns p (n_p,), the shared ones first."""
        n_shared = len(self.shared.start)
        return self.shared.values(p[:n_shared]) | self.per_recording.values(p[n_shared:])


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
    """Number of states."""
    n_u: int
    """Number of actuators."""
    n_j: int
    """Number of joints."""
    n_p: int
    """Number of unknowns."""


@checked
def stage_of(vehicle: Vehicle, *, sharp: bool = False) -> StageFunctions:
    """Build the functions of one step of a vehicle: motion, outputs of sensors, and slopes.

    sharp: True for sharp edges of dead zones that are known; a search for commands needs smooth ones.
    """
    n_u = len(vehicle.actuators.names)
    n_j = vehicle.dynamics.model.nv - N_V
    x = ca.SX.sym("x", N_Q + N_V + n_u)
    u = ca.SX.sym("u", n_u)
    joints = ca.SX.sym("joints", 3 * n_j)
    p = ca.SX.sym("p", vehicle.n_p)
    h = ca.SX.sym("h")
    values = vehicle.values(p)
    quantities = vehicle.shared.declaration.quantities
    dead_zones = (quantities["dead_zone"], quantities["dead_zone_reverse"])
    is_learnt = any(zone.free.any() for zone in dead_zones)
    if sharp and not is_learnt:
        edge = _KNOWN_EDGE
    else:
        edge = _LEARNT_EDGE
    next_state = _next_state(vehicle, values, x, u, joints, h, edge)
    outputs = _outputs(values, x)
    past = ca.SX.sym("past", n_u, PAST)
    begun = _begun(vehicle, values, past, edge)
    delays = ca.vertcat(values["delay"], values["velocity_delay"])
    arguments = [x, u, joints, p, h]
    options = {"cse": True}
    slopes = _dense_jacobians(next_state, x, p, u)
    return StageFunctions(
        step=ca.Function("step", arguments, [ca.densify(next_state)], options),
        slope=ca.Function("slope", arguments, slopes, options),
        outputs=ca.Function(
            "seen", [x, p], [ca.densify(outputs), *_dense_jacobians(outputs, x, p)]
        ),
        begun=ca.Function(
            "begun", [past, p], [ca.densify(begun), *_dense_jacobians(begun, p, past)]
        ),
        delays=ca.Function("delays", [p], [ca.densify(delays), *_dense_jacobians(delays, p)]),
        n_x=x.numel(),
        n_u=n_u,
        n_j=n_j,
        n_p=vehicle.n_p,
    )


def _dense_jacobians(expression: ca.SX, *variables: ca.SX) -> list[ca.SX]:
    """Differentiate an expression by each of some variables."""
    return [ca.densify(ca.jacobian(expression, variable)) for variable in variables]


def _next_state(
    vehicle: Vehicle,
    values: dict[str, ca.SX],
    x: ca.SX,
    u: ca.SX,
    joints: ca.SX,
    h: ca.SX,
    edge: float,
) -> ca.SX:
    """Compute the state after a step of h [s], see the module."""
    integrate = vehicle.dynamics.symbolic.joints[0].kind.integrate
    q = x[:N_Q]
    thrust = x[N_Q + N_V :]
    moves = ca.DM(np.isin(np.arange(N_V), vehicle.axes).astype(float))
    nu = x[N_Q : N_Q + N_V] * moves
    target = _target(vehicle, values, u, edge)
    decay = ca.exp(-h / values["lag"])
    mean_thrust = target + (thrust - target) * (1 - decay) * values["lag"] / h
    q_middle = integrate(q, nu * h / 2)
    first_slope = _acceleration(vehicle, values, q_middle, nu, mean_thrust, joints)
    nu_middle = nu + h / 2 * first_slope
    nu_next = nu + h * _acceleration(vehicle, values, q_middle, nu_middle, mean_thrust, joints)
    q_next = integrate(q_middle, nu_next * h / 2)
    thrust_next = target + (thrust - target) * decay
    return ca.vertcat(q_next, nu_next, thrust_next)


def _target(vehicle: Vehicle, values: dict[str, ca.SX], u: ca.SX, edge: float) -> ca.SX:
    """Compute the steady thrust for commands u: next to nothing in the dead zone; beyond it all, or
    less by the zone's size.
    """
    beyond = _less_beyond
    if vehicle.actuators.whole_beyond:
        beyond = _whole_beyond
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
    """Compute commands u beyond a dead zone, less its size."""
    width = edge * dead
    return width * ca.log1p(ca.exp(-ca.fabs(u - dead) / width)) + ca.fmax(u - dead, 0)


def _whole_beyond(u: ca.SX, dead: ca.SX, edge: float) -> ca.SX:
    """Compute commands u, in full beyond a dead zone."""
    return u * (1 + ca.tanh((u - dead) / (2 * edge * dead))) / 2


def _acceleration(
    vehicle: Vehicle, values: dict[str, ca.SX], q: ca.SX, nu: ca.SX, thrust: ca.SX, joints: ca.SX
) -> ca.SX:
    """Compute the acceleration (6,) of the vehicle in B, 0 along axes that are held."""
    dynamics = vehicle_dynamics(vehicle.dynamics, values, vehicle.link)
    n_j = joints.numel() // 3
    n_links = len(dynamics.links)
    all_q = ca.vertcat(q, joints[:n_j])
    all_v = ca.vertcat(nu, joints[n_j : 2 * n_j])
    joint_acceleration = ca.vertcat(ca.SX(N_V, 1), joints[2 * n_j :])
    current = ca.repmat(values["current"], 1, n_links)
    current_rate = ca.SX(3, n_links)
    wrench = ca.DM(vehicle.actuators.wrench) @ thrust + values["bias"] + values["wrench_offset"]
    needed = dynamics.inverse_dynamics(all_q, all_v, joint_acceleration, current, current_rate)
    force = wrench - needed[:N_V]
    axes = list(vehicle.axes)
    D, L_transposed, order = ca.ldl(dynamics.mass_matrix(all_q)[axes, axes], False)
    acceleration = ca.SX(N_V, 1)
    acceleration[axes] = ca.ldl_solve(force[axes], D, L_transposed, order)
    return acceleration


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


def _outputs(values: dict[str, ca.SX], x: ca.SX) -> ca.SX:
    """Compute the outputs (9,) of `StageFunctions.outputs`."""
    linear = x[N_Q : N_Q + 3]
    angular = x[N_Q + 3 : N_Q + N_V]
    vertical = quaternion_to_matrix(x[3:N_Q])[2, :].T
    velocity = linear + cross(angular, values["velocity_point"])
    rate = as_measured(values, angular) + values["rate_bias"]
    return ca.vertcat(velocity, rate, as_measured(values, vertical))


def as_measured(values: dict[str, ca.SX], vector: ca.SX) -> ca.SX:
    """Turn a vector (3,) [any] in B to the axes of the sensor of attitude."""
    return exp3(values["attitude_turn"] + values["attitude_offset"]).T @ vector
