"""One time step of a robot in water as a CasADi Function.

The step is implicit in everything stiff and dissipative: with h the bias force and G the slope of drag, joint friction,
joint stops and floor contact with respect to velocity,

    (M + dt G) (v_next - v) = dt (tau + contact + stops - h(q, v)),    q_next = q (+) v_next dt.

Added mass is part of M, so the step stays stable where it exceeds the dry mass; G keeps a coarse step from overshooting
the drag. First order in dt. A joint that is locked has v_next = 0 in place of its row: the force that holds it is solved
for, and where it still moved, the first step is the impulse that stops it, which leaves all other momenta as they were.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from uvms_ocp.functions.elementwise import clipped
from uvms_ocp.model.limits import bounded_joints
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.spatial import skew
from uvms_ocp.model.symbolic.dynamics import SymbolicDynamics
from uvms_ocp.model.symbolic.joint_types import sparse
from uvms_ocp.model.thrusters import thruster_matrix
from uvms_ocp.sim.contact import ContactModel
from uvms_ocp.sim.thrusters import N_DECAYS, Thrusters, joint_power

CARRIED = ("q", "v", "thrust", "thruster_energy", "joint_energy")
"""What one step hands to the next."""
INPUTS = (
    *(*CARRIED, "asked_thrust", "asked_torque", "share", "offset", "decay"),
    *("u", "Du_Dt", "floor_z", "floor_normal", "brake", "dt"),
)
"""Of `step_function`."""


@dataclass(frozen=True, kw_only=True, slots=True)
class JointStops:
    """Spring and damper behind every joint limit (assumed)."""

    stiffness: float = 1e4
    """[N m/rad]"""
    damping: float = 1e2
    """[N m s/rad]"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class StepModel:
    """What the step function is built from."""

    robot: Robot
    """What moves."""
    dynamics: SymbolicDynamics
    """Its own, in water."""
    points: np.ndarray
    """(n_points, 3) [m] contact points in B."""
    contact: ContactModel
    """Of every point."""
    stops: JointStops
    """Of every joint."""
    thrusters: Thrusters
    """Of the robot."""
    locked: tuple[int, ...] = ()
    """[-] entries of v that a constraint holds at 0."""


def step_function(model: StepModel) -> ca.Function:
    """Function of one step of dt [s], whose first results are the first inputs of the next.

    ``q, v, thrust, thruster_energy, joint_energy, asked_thrust, asked_torque, share, offset, decay, u, Du_Dt, floor_z,
    floor_normal, brake, dt -> q, v, thrust, thruster_energy, joint_energy, torque, contact``, the names of the first five
    results with ``_next``.

    thrust (n_thrusters,) [N], thruster_energy (n_thrusters,) [J] and joint_energy [J] so far. asked_thrust (n_thrusters,) [N]
    and asked_torque (n_joints,) [N m or N]: the command; torque is what the motors give of it. share, offset (n_thrusters,)
    [-, N]: `ThrusterCondition`. decay (n_thrusters, N_DECAYS) [-]: `Thrusters.decay`. u (3, n_links) [m/s] and Du_Dt
    (3, n_links) [m/s2]: water at the links. floor_z (n_points,) [m] and floor_normal (3, n_points) [-]: height and normal of
    the floor below the contact points. brake [N m s/rad]: friction of the brakes on every joint. contact (n_points,) [N]: the
    vertical force of the floor on each point.
    """
    robot, x = model.robot, _inputs(model)
    torque = clipped(x["asked_torque"], -robot.limits.effort, robot.limits.effort)
    target = model.thrusters.target(x["asked_thrust"], x["share"], x["offset"])
    thrust, taken = model.thrusters.step(x["thrust"], target, x["decay"], x["dt"])
    wrench = sparse(thruster_matrix(robot)) @ thrust
    v_next, contact = _velocity(model, x, ca.vertcat(wrench[: robot.n_vehicle], torque))
    q_next = _unit_quaternion(robot, model.dynamics.symbolic.integrate(x["q"], v_next * x["dt"]))
    power = joint_power(torque, v_next[robot.joint_v], robot.description.joint_efficiency)
    spent = x["joint_energy"] + x["dt"] * ca.sum1(power)
    outputs = [q_next, v_next, thrust, x["thruster_energy"] + taken, spent, torque, contact]
    names = [*(f"{name}_next" for name in CARRIED), "torque", "contact"]
    return ca.Function("plant_step", [*x.values()], [ca.densify(y) for y in outputs], [*x], names, {"cse": True})


def _inputs(model: StepModel) -> dict[str, ca.SX]:
    robot, n_links, n_points = model.robot, len(model.dynamics.links), len(model.points)
    n_thrusters = len(model.thrusters.lower)
    sizes = {"q": robot.n_q, "v": robot.n_v, "asked_torque": robot.n_joints, "floor_z": n_points}
    sizes |= {"joint_energy": 1, "brake": 1, "dt": 1}
    tables = {"decay": (n_thrusters, N_DECAYS), "u": (3, n_links), "Du_Dt": (3, n_links), "floor_normal": (3, n_points)}
    return {name: ca.SX.sym(name, *tables.get(name, (sizes.get(name, n_thrusters), 1))) for name in INPUTS}


def _velocity(model: StepModel, x: Mapping[str, ca.SX], tau: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Velocity (n_v,) [m/s, rad/s] after the step under the generalized force tau (n_v,), and the contact (n_points,) [N]."""
    q, v, u, dt = x["q"], x["v"], x["u"], x["dt"]
    force, slope_stops = _stops(model, q, v, dt)
    brakes = x["brake"] * ca.vertcat(ca.SX.zeros(model.robot.n_vehicle), ca.SX.ones(model.robot.n_joints))
    pushes, contact, slope_contact = _contact(model, q, v, x["floor_z"], x["floor_normal"], dt)
    G = model.dynamics.drag_slope(q, v, u) + ca.diag(slope_stops + brakes) + slope_contact
    h = model.dynamics.bias_force(q, v, u, x["Du_Dt"])
    A, impulse = model.dynamics.mass_matrix(q) + dt * G, dt * (tau + force + contact - brakes * v - h)
    return _accelerated(A, v, impulse, model.locked), pushes


def _accelerated(A: ca.SX, v: ca.SX, impulse: ca.SX, locked: tuple[int, ...]) -> ca.SX:
    """v_next (n_v,) of ``A (v_next - v) = impulse`` in the rows that are free, and 0 in the locked ones."""
    free, held = [i for i in range(v.numel()) if i not in locked], list(locked)
    if held:
        impulse = impulse[free] + A[free, held] @ v[held]
        A = A[free, free]
    D, L_transposed, order = ca.ldl(A, False)
    change = ca.ldl_solve(impulse, D, L_transposed, order)
    if not held:
        return v + change
    v_next = ca.SX.zeros(v.numel())
    v_next[free] = v[free] + change
    return v_next


def _stops(model: StepModel, q: ca.SX, v: ca.SX, dt: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Generalized force (n_v,) [N, N m] of joints beyond their limits, and what it adds to G (n_v,)."""
    force, slope = ca.SX.zeros(model.robot.n_v), ca.SX.zeros(model.robot.n_v)
    k, d = model.stops.stiffness, model.stops.damping
    for joint, lower, upper in bounded_joints(model.robot.joints, model.robot.limits):
        beyond = ca.fmin(q[joint.idx_q] - lower, 0) + ca.fmax(q[joint.idx_q] - upper, 0)
        touching = beyond != 0
        force[joint.idx_v] = ca.if_else(touching, -k * beyond - (d + dt * k) * v[joint.idx_v], 0)
        slope[joint.idx_v] = ca.if_else(touching, d + dt * k, 0)
    return force, slope


def _contact(
    model: StepModel, q: ca.SX, v: ca.SX, floor_z: ca.SX, normal: ca.SX, dt: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Vertical force [N] per point, the generalized force (n_v,) [N, N m] of all, and what they add to G (n_v, n_v)."""
    n_v = model.robot.n_v
    total, slope = ca.SX.zeros(n_v), ca.SX(n_v, n_v)
    if not len(model.points):
        return ca.SX(0, 1), total, slope
    pose = model.dynamics.symbolic.joint_poses(model.dynamics.symbolic.local_poses(q))[1]
    vertical = []
    for index, point in enumerate(model.points):
        p_B = ca.DM(point)
        J = ca.horzcat(pose.R, -pose.R @ skew(ca.SX(p_B)))
        depth = (floor_z[index] - (pose.p + pose.R @ p_B)[2]) * normal[2, index]
        force_W, slope_W = model.contact.force(depth, J @ v[:6], normal[:, index], dt)
        total[:6] += J.T @ force_W
        slope[:6, :6] += J.T @ slope_W @ J
        vertical.append(force_W[2])
    return ca.vertcat(*vertical), total, slope


def _unit_quaternion(robot: Robot, q: ca.SX) -> ca.SX:
    """q with the vehicle's quaternion scaled to norm 1, so that rounding does not add up over a run."""
    if not robot.n_vehicle:
        return q
    return ca.vertcat(q[:3], q[3:7] / ca.norm_2(q[3:7]), q[7:])
