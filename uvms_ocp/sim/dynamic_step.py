"""One time step of a robot in water as a CasADi Function.

The step is implicit in everything stiff and dissipative: with h the bias force and G the slope of drag, joint friction,
joint stops and floor contact with respect to velocity,

    (M + dt G) (v_next - v) = dt (tau + contact + stops - h(q, v)),    q_next = q (+) v_next dt.

Added mass is part of M, so the step stays stable where it exceeds the dry mass; G keeps a coarse step from overshooting
the drag. First order in dt. A joint that is locked has v_next = 0 in place of its row: the force that holds it is solved
for, and where it still moved, the first step is the impulse that stops it, which leaves all other momenta as they were.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from uvms_ocp.model.limits import bounded_joints
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.spatial import skew
from uvms_ocp.model.symbolic.dynamics import SymbolicDynamics
from uvms_ocp.sim.contact import ContactModel


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
    locked: tuple[int, ...] = ()
    """[-] entries of v that a constraint holds at 0."""


def step_function(model: StepModel) -> ca.Function:
    """Function ``q, v, tau, u, Du_Dt, floor_z, floor_normal, brake, dt -> q_next, v_next, contact``.

    tau (n_v,) [N, N m]: generalized force of thrusters and motors. u (3, n_links) [m/s] and Du_Dt (3, n_links) [m/s2]:
    water at the links. floor_z (n_points,) [m] and floor_normal (3, n_points) [-]: height and normal of the floor below
    the contact points. brake [N m s/rad]: friction of the brakes on every joint. dt [s]. contact (n_points,) [N]: the
    vertical force of the floor on each point.
    """
    robot, n_links, n_points = model.robot, len(model.dynamics.links), len(model.points)
    q, v, tau = (ca.SX.sym(name, n) for name, n in (("q", robot.n_q), ("v", robot.n_v), ("tau", robot.n_v)))
    u, Du_Dt = ca.SX.sym("u", 3, n_links), ca.SX.sym("Du_Dt", 3, n_links)
    floor_z, normal = ca.SX.sym("floor_z", n_points), ca.SX.sym("floor_normal", 3, n_points)
    brake, dt = ca.SX.sym("brake"), ca.SX.sym("dt")

    force, slope_stops = _stops(model, q, v, dt)
    brakes = brake * ca.vertcat(ca.SX.zeros(robot.n_vehicle), ca.SX.ones(robot.n_joints))
    pushes, contact, slope_contact = _contact(model, q, v, floor_z, normal, dt)
    G = model.dynamics.drag_slope(q, v, u) + ca.diag(slope_stops + brakes) + slope_contact
    h = model.dynamics.bias_force(q, v, u, Du_Dt)
    A, impulse = model.dynamics.mass_matrix(q) + dt * G, dt * (tau + force + contact - brakes * v - h)
    v_next = _accelerated(A, v, impulse, model.locked)
    q_next = model.dynamics.symbolic.integrate(q, v_next * dt)

    inputs = {"q": q, "v": v, "tau": tau, "u": u, "Du_Dt": Du_Dt}
    inputs |= {"floor_z": floor_z, "floor_normal": normal, "brake": brake, "dt": dt}
    outputs = {"q_next": _unit_quaternion(robot, q_next), "v_next": v_next, "contact": pushes}
    dense = [ca.densify(value) for value in outputs.values()]
    return ca.Function("plant_step", [*inputs.values()], dense, [*inputs], [*outputs], {"cse": True})


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
