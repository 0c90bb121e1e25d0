"""Semi-implicit Euler step of a robot in water as a CasADi Function, with contact of its hull with
the floor; a period of steps.

The step is implicit in everything stiff and dissipative: with h the bias force and G the slope of
drag, joint friction, joint stops and floor contact with respect to velocity,

    (M + dt G) (v_next - v) = dt (tau + contact + stops - h(q, v)),    q_next = q (+) v_next dt.

Added mass is part of M, so the step stays stable where it exceeds the dry mass; G keeps a coarse
step from overshooting the drag. First order in dt. A joint that is locked has v_next = 0 in place
of its row: the force that holds it is solved for, and where it still moved, the first step is the
impulse that stops it, which leaves all other momenta as they were.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import casadi as ca
import numpy as np

from uvms_ocp.codegen import elementwise
from uvms_ocp.codegen.kernel_layout import (
    CallbackField,
    FunctionField,
    Layout,
    Sized,
    Vector,
    structure_of,
)
from uvms_ocp.robot import (
    Robot,
    limits,
    spatial,
    symbolic_bodies,
    symbolic_dynamics,
    thruster_matrix,
)
from uvms_ocp.robot.dimensions import dimensions_of
from uvms_ocp.robot.electrical_power import joint_power
from uvms_ocp.robot.size import joint_strength, joint_units
from uvms_ocp.sim.seafloor_contact import ContactModel
from uvms_ocp.sim.thrusters import N_DECAYS, Thrusters

CARRIED = ("q", "v", "thrust", "thruster_energy", "joint_energy")
"""State that one step hands to the next."""
INPUTS = (
    *(*CARRIED, "asked_thrust", "asked_torque", "share", "offset", "decay"),
    *("u", "Du_Dt", "floor_z", "floor_normal", "brake", "dt"),
)
"""Inputs of `step_function`."""
TABLES = ("decay", "u", "Du_Dt", "floor_normal")
"""Inputs that keep both axes, also with one column."""


@dataclass(frozen=True, kw_only=True, slots=True)
class JointStops:
    """Spring and damper behind every joint limit, and the brakes, all of `joint_strength` (assumed)."""

    deflection: float = 1e-3
    """[rad, or share of the robot's size] Deflection of a stop under `joint_strength`."""
    settling: float = 0.01
    """[s] Damping of a stop, over its stiffness."""
    creep: float = 1e-5
    """[rad/s, or share of the robot's size per second] Rate at which a locked joint gives way to
    `joint_strength`: less than a milliradian in a minute.
    """

    def stiffness(self, robot: Robot) -> np.ndarray:
        """Return the stiffness (n_joints,) [N m/rad or N/m] of the stops."""
        return joint_strength(robot) / (self.deflection * joint_units(robot))

    def brake_friction(self, robot: Robot) -> np.ndarray:
        """Return the friction (n_joints,) [N m s/rad or N s/m] of locked brakes."""
        return joint_strength(robot) / (self.creep * joint_units(robot))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class StepModel:
    """Constants that the step function is built from."""

    robot: Robot
    """The robot that moves."""
    dynamics: symbolic_dynamics.SymbolicDynamics
    """Dynamics of the robot in water."""
    points: np.ndarray
    """(n_points, 3) [m] contact points in B."""
    contact: ContactModel
    """Law of contact with the floor, one for all points."""
    stops: JointStops
    """Law of the stops at the limits and of the brakes, one for all joints."""
    thrusters: Thrusters
    """The thrusters of the robot."""
    locked: tuple[int, ...] = ()
    """Entries of v that a constraint holds at 0."""


def step_function(model: StepModel) -> ca.Function:
    """Build the function of one step of dt [s], whose first results are the first inputs of the
    next.

    ``q, v, thrust, thruster_energy, joint_energy, asked_thrust, asked_torque, share, offset, decay,
    u, Du_Dt, floor_z, floor_normal, brake, dt -> q, v, thrust, thruster_energy, joint_energy,
    torque, contact``, the names of the first five results with ``_next``.

    thrust (n_thrusters,) [N], thruster_energy (n_thrusters,) [J] and joint_energy [J] so far.
    asked_thrust (n_thrusters,) [N] and asked_torque (n_joints,) [N m or N]: the command; torque is
    what the motors give of it. share, offset (n_thrusters,) [-, N]: `ThrusterCondition`. decay
    (n_thrusters, N_DECAYS): `Thrusters.decay`. u (3, n_links) [m/s] and Du_Dt (3, n_links) [m/s2]:
    water at the links. floor_z (n_points,) [m] and floor_normal (3, n_points): height and normal of
    the floor below the contact points. brake [-]: 1 where brakes lock every joint, else 0.
    contact (n_points,) [N]: the vertical force of the floor on each point.
    """
    robot = model.robot
    x = _inputs(model)
    torque = elementwise.clipped(x["asked_torque"], -robot.limits.effort, robot.limits.effort)
    target = model.thrusters.target(x["asked_thrust"], x["share"], x["offset"])
    thrust, thruster_energy = model.thrusters.step(x["thrust"], target, x["decay"], x["dt"])
    wrench = symbolic_bodies.sparse(thruster_matrix(robot)) @ thrust
    v_next, contact = _velocity(model, x, ca.vertcat(wrench[: robot.n_vehicle], torque))
    q_next = model.dynamics.symbolic.integrate(x["q"], v_next * x["dt"])
    if (
        robot.n_vehicle
    ):  # whose quaternion keeps norm 1, so that rounding does not add up over a run
        q_next = ca.vertcat(q_next[:3], q_next[3:7] / ca.norm_2(q_next[3:7]), q_next[7:])
    power = joint_power(torque, v_next[robot.joint_v], robot.description.joint_efficiency)
    spent = x["joint_energy"] + x["dt"] * ca.sum1(power)
    outputs = [
        q_next,
        v_next,
        thrust,
        x["thruster_energy"] + thruster_energy,
        spent,
        torque,
        contact,
    ]
    names = [*(f"{name}_next" for name in CARRIED), "torque", "contact"]
    return ca.Function(
        "plant_step", [*x.values()], [ca.densify(y) for y in outputs], [*x], names, {"cse": True}
    )


def _inputs(model: StepModel) -> dict[str, ca.SX]:
    robot = model.robot
    n_links = len(model.dynamics.links)
    n_points = len(model.points)
    n_thrusters = len(model.thrusters.lower)
    sizes = {"q": robot.n_q, "v": robot.n_v, "asked_torque": robot.n_joints, "floor_z": n_points}
    sizes |= {"joint_energy": 1, "brake": 1, "dt": 1}
    tables = zip(
        TABLES, ((n_thrusters, N_DECAYS), (3, n_links), (3, n_links), (3, n_points)), strict=True
    )
    shapes = {name: (sizes.get(name, n_thrusters), 1) for name in INPUTS} | dict(tables)
    return {name: ca.SX.sym(name, *shapes[name]) for name in INPUTS}


def _velocity(model: StepModel, x: Mapping[str, ca.SX], tau: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Compute the velocity (n_v,) [m/s, rad/s] after the step under the generalized force tau
    (n_v,), and the contact (n_points,) [N].
    """
    q = x["q"]
    v = x["v"]
    u = x["u"]
    dt = x["dt"]
    force, slope_stops = _stops(model, q, v, dt)
    friction = model.stops.brake_friction(model.robot)
    brakes = x["brake"] * ca.vertcat(ca.SX.zeros(model.robot.n_vehicle), ca.SX(friction))
    pushes, contact, slope_contact = _contact(model, q, v, x["floor_z"], x["floor_normal"], dt)
    G = model.dynamics.drag_slope(q, v, u) + ca.diag(slope_stops + brakes) + slope_contact
    h = model.dynamics.bias_force(q, v, u, x["Du_Dt"])
    A = model.dynamics.mass_matrix(q) + dt * G
    impulse = dt * (tau + force + contact - brakes * v - h)
    return _accelerated(A, v, impulse, model.locked), pushes


def _accelerated(A: ca.SX, v: ca.SX, impulse: ca.SX, locked: tuple[int, ...]) -> ca.SX:
    """Solve ``A (v_next - v) = impulse`` for v_next (n_v,) in the rows that are free, with 0 in the
    locked ones.
    """
    free = [i for i in range(v.numel()) if i not in locked]
    if locked:
        impulse = impulse[free] + A[free, list(locked)] @ v[list(locked)]
        A = A[free, free]
    D, L_transposed, order = ca.ldl(A, False)
    change = ca.ldl_solve(impulse, D, L_transposed, order)
    if not locked:
        return v + change
    v_next = ca.SX.zeros(v.numel())
    v_next[free] = v[free] + change
    return v_next


def _stops(model: StepModel, q: ca.SX, v: ca.SX, dt: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Compute the generalized force (n_v,) [N, N m] of joints beyond their limits, and what it adds
    to G (n_v,).
    """
    force = ca.SX.zeros(model.robot.n_v)
    slope = ca.SX.zeros(model.robot.n_v)
    stiffness = model.stops.stiffness(model.robot)
    for joint, lower, upper in limits.bounded_joints(model.robot.joints, model.robot.limits):
        at = joint.position(q)
        k = float(stiffness[joint.idx_v - model.robot.n_vehicle])
        d = model.stops.settling * k
        beyond = ca.fmin(at - lower, 0) + ca.fmax(at - upper, 0)
        touching = beyond != 0
        push = -k * beyond - (d + dt * k) * v[joint.idx_v]
        force[joint.idx_v] = ca.if_else(touching, push, 0)
        slope[joint.idx_v] = ca.if_else(touching, d + dt * k, 0)
    return force, slope


def _contact(
    model: StepModel, q: ca.SX, v: ca.SX, floor_z: ca.SX, normal: ca.SX, dt: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Compute the vertical force [N] on each point, the generalized force (n_v,) [N, N m] of all,
    and what they add to G (n_v, n_v).
    """
    n_v = model.robot.n_v
    total = ca.SX.zeros(n_v)
    slope = ca.SX(n_v, n_v)
    if not len(model.points):
        return ca.SX(0, 1), total, slope
    pose = model.dynamics.symbolic.joint_poses(model.dynamics.symbolic.local_poses(q))[1]
    vertical = []
    for index, point in enumerate(model.points):
        p_B = ca.DM(point)
        J = ca.horzcat(pose.R, -pose.R @ spatial.skew(ca.SX(p_B)))
        depth = (floor_z[index] - (pose.p + pose.R @ p_B)[2]) * normal[2, index]
        force_W, slope_W = model.contact.force(depth, J @ v[:6], normal[:, index], dt)
        total[:6] += J.T @ force_W
        slope[:6, :6] += J.T @ slope_W @ J
        vertical.append(force_W[2])
    return ca.vertcat(*vertical), total, slope


# A control period of the physical plant: several steps, as a kernel on memory that is written to in
# place.


class PlantMemory(Layout):
    """State of the plant, what acts on it, and the step that moves it. Arrays are the arguments of
    `step_function`, column after column.
    """

    step: FunctionField
    sampled: bool
    """`sample` is asked for water and floor at the beginning of a period."""
    sample: CallbackField
    t: float
    """[s] time of the state."""
    dt: float
    """[s] Control period."""
    n_steps: int
    """Number of steps in a period."""
    step_dt: float
    """[s] Length of a step."""
    q: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] configuration."""
    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] velocity."""
    a: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s2, rad/s2] mean acceleration over the last period, as an accelerometer would
    integrate it.
    """
    thrust: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [N] thrust."""
    thruster_energy: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [J] electrical energy of the thrusters so far."""
    joint_energy: Annotated[Vector, Sized(1)]
    """(1,) [J] electrical energy of the joints so far."""
    asked_thrust: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [N] commanded thrust."""
    asked_torque: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [N m or N] commanded torque."""
    share: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) share of its command that each thruster gives."""
    offset: Annotated[Vector, Sized("n_thrusters")]
    """(n_thrusters,) [N] thrust at which stuck thrusters stay."""
    decay: Annotated[Vector, Sized("n_decays")]
    """(n_thrusters * N_DECAYS,) `Thrusters.decay` of a step."""
    u: Annotated[Vector, Sized("n_water")]
    """(3 * n_links,) [m/s] velocities of the water at the links."""
    Du_Dt: Annotated[Vector, Sized("n_water")]
    """(3 * n_links,) [m/s2] the water's own accelerations at the links."""
    floor_z: Annotated[Vector, Sized("n_points")]
    """(n_points,) [m] height in W of the floor below each contact point."""
    floor_normal: Annotated[Vector, Sized("n_normals")]
    """(3 * n_points,) normal of the floor there, in W."""
    brake: float
    """1 where the brakes are locked, 0 where they are open."""
    torque: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [N m or N] torques of the motors in the last step."""
    contact: Annotated[Vector, Sized("n_points")]
    """(n_points,) [N] contact forces of the last step."""
    v_before: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] velocity at the beginning of the period."""
    q_next: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] configuration after a step."""
    v_next: Annotated[Vector, Sized("n_v")]
    thrust_next: Annotated[Vector, Sized("n_thrusters")]
    thruster_energy_next: Annotated[Vector, Sized("n_thrusters")]
    joint_energy_next: Annotated[Vector, Sized(1)]


def advance_plant(plant: PlantMemory) -> None:
    """Move the plant by one control period. A kernel."""
    if plant.sampled:
        plant.sample()
    plant.v_before[:] = plant.v
    for _ in range(plant.n_steps):
        plant.step(
            plant.q,
            plant.v,
            plant.thrust,
            plant.thruster_energy,
            plant.joint_energy,
            plant.asked_thrust,
            plant.asked_torque,
            plant.share,
            plant.offset,
            plant.decay,
            plant.u,
            plant.Du_Dt,
            plant.floor_z,
            plant.floor_normal,
            plant.brake,
            plant.step_dt,
            plant.q_next,
            plant.v_next,
            plant.thrust_next,
            plant.thruster_energy_next,
            plant.joint_energy_next,
            plant.torque,
            plant.contact,
        )
        plant.q[:] = plant.q_next
        plant.v[:] = plant.v_next
        plant.thrust[:] = plant.thrust_next
        plant.thruster_energy[:] = plant.thruster_energy_next
        plant.joint_energy[:] = plant.joint_energy_next
    for i in range(len(plant.v)):
        plant.a[i] = (plant.v[i] - plant.v_before[i]) / plant.dt
    plant.t += plant.dt


def plant_structure(model: StepModel, step: ca.Function) -> type[PlantMemory]:
    """Return the type of the memory of a plant with this `step_function`."""
    dimensions = dimensions_of(model.robot)
    n_points = len(model.points)
    return structure_of(
        PlantMemory,
        dimensions,
        step=step,
        n_decays=dimensions.n_thrusters * N_DECAYS,
        n_water=3 * len(model.dynamics.links),
        n_points=n_points,
        n_normals=3 * n_points,
    )
