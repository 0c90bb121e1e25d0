"""Semi-implicit Euler step of a robot in water as a CasADi Function, with contact of its hull with the floor; a period of steps.

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
from functools import lru_cache

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.codegen import buffered, elementwise
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import Robot, limits, spatial, symbolic_bodies, symbolic_dynamics, thruster_matrix
from uvms_ocp.robot.thrusters import joint_power
from uvms_ocp.sim.thrusters import N_DECAYS, Thrusters
from uvms_ocp.types import Positive

# Contact of the vehicle's hull with the seafloor: a spring and damper at each corner of its underside.
#
# The floor pushes and never pulls; friction is Coulomb's, regularised below a creeping speed.


@checked_dataclass()
class ContactModel:
    """Stiffness and damping per corner. Raises `InvalidInput` for a number that is not > 0.

    The values are assumed: no public measurement of a skid on sediment.
    """

    stiffness: Positive = 2e4
    """[N/m]"""
    damping: Positive = 2e3
    """[N s/m]"""
    friction: Positive = 0.5
    creep: Positive = 0.01
    """[m/s] speed below which friction is viscous."""

    def force(self, depth: ca.SX, velocity_W: ca.SX, normal_W: ca.SX, dt: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Force (3,) [N] in W on a point `depth` [m] below the floor that moves with velocity_W (3,) [m/s], and its slope.

        The slope (3, 3) [N s/m], minus the derivative with respect to velocity over a step dt [s], makes the step implicit.
        """
        speed, damping = ca.dot(velocity_W, normal_W), self.damping + dt * self.stiffness
        pressing = ca.if_else(depth > 0, ca.fmax(self.stiffness * depth - damping * speed, 0), 0)
        sliding = velocity_W - speed * normal_W
        grip = self.friction * pressing / ca.sqrt(ca.sumsqr(sliding) + self.creep**2)
        across = ca.SX.eye(3) - normal_W @ normal_W.T
        slope = ca.if_else(pressing > 0, damping, 0) * (normal_W @ normal_W.T) + grip * across
        return pressing * normal_W - grip * sliding, slope


# One time step of a robot in water as a CasADi Function.
#
# The step is implicit in everything stiff and dissipative: with h the bias force and G the slope of drag, joint friction,
# joint stops and floor contact with respect to velocity,
#
#     (M + dt G) (v_next - v) = dt (tau + contact + stops - h(q, v)),    q_next = q (+) v_next dt.
#
# Added mass is part of M, so the step stays stable where it exceeds the dry mass; G keeps a coarse step from overshooting
# the drag. First order in dt. A joint that is locked has v_next = 0 in place of its row: the force that holds it is solved
# for, and where it still moved, the first step is the impulse that stops it, which leaves all other momenta as they were.

CARRIED = ("q", "v", "thrust", "thruster_energy", "joint_energy")
"""State that one step hands to the next."""
INPUTS = (
    *(*CARRIED, "asked_thrust", "asked_torque", "share", "offset", "decay"),
    *("u", "Du_Dt", "floor_z", "floor_normal", "brake", "dt"),
)
"""Inputs of `step_function`."""
TABLES = ("decay", "u", "Du_Dt", "floor_normal")
"""Those that keep both axes, also with one column."""


@dataclass(frozen=True, kw_only=True, slots=True)
class JointStops:
    """Spring and damper behind every joint limit (assumed)."""

    stiffness: float = 1e4
    """[N m/rad]"""
    damping: float = 1e2
    """[N m s/rad]"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class StepModel:
    """Constants that the step function is built from."""

    robot: Robot
    """The robot that moves."""
    dynamics: symbolic_dynamics.SymbolicDynamics
    """Its own, in water."""
    points: np.ndarray
    """(n_points, 3) [m] contact points in B."""
    contact: ContactModel
    """The same for every point."""
    stops: JointStops
    """The same for every joint."""
    thrusters: Thrusters
    """The thrusters of the robot."""
    locked: tuple[int, ...] = ()
    """Entries of v that a constraint holds at 0."""


def step_function(model: StepModel) -> ca.Function:
    """Function of one step of dt [s], whose first results are the first inputs of the next.

    ``q, v, thrust, thruster_energy, joint_energy, asked_thrust, asked_torque, share, offset, decay, u, Du_Dt, floor_z,
    floor_normal, brake, dt -> q, v, thrust, thruster_energy, joint_energy, torque, contact``, the names of the first five
    results with ``_next``.

    thrust (n_thrusters,) [N], thruster_energy (n_thrusters,) [J] and joint_energy [J] so far. asked_thrust (n_thrusters,) [N]
    and asked_torque (n_joints,) [N m or N]: the command; torque is what the motors give of it. share, offset (n_thrusters,)
    [-, N]: `ThrusterCondition`. decay (n_thrusters, N_DECAYS): `Thrusters.decay`. u (3, n_links) [m/s] and Du_Dt
    (3, n_links) [m/s2]: water at the links. floor_z (n_points,) [m] and floor_normal (3, n_points): height and normal of
    the floor below the contact points. brake [N m s/rad]: friction of the brakes on every joint. contact (n_points,) [N]: the
    vertical force of the floor on each point.
    """
    robot, x = model.robot, _inputs(model)
    torque = elementwise.clipped(x["asked_torque"], -robot.limits.effort, robot.limits.effort)
    target = model.thrusters.target(x["asked_thrust"], x["share"], x["offset"])
    thrust, taken = model.thrusters.step(x["thrust"], target, x["decay"], x["dt"])
    wrench = symbolic_bodies.sparse(thruster_matrix(robot)) @ thrust
    v_next, contact = _velocity(model, x, ca.vertcat(wrench[: robot.n_vehicle], torque))
    q_next = model.dynamics.symbolic.integrate(x["q"], v_next * x["dt"])
    if robot.n_vehicle:  # whose quaternion keeps norm 1, so that rounding does not add up over a run
        q_next = ca.vertcat(q_next[:3], q_next[3:7] / ca.norm_2(q_next[3:7]), q_next[7:])
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
    tables = zip(TABLES, ((n_thrusters, N_DECAYS), (3, n_links), (3, n_links), (3, n_points)), strict=True)
    shapes = {name: (sizes.get(name, n_thrusters), 1) for name in INPUTS} | dict(tables)
    return {name: ca.SX.sym(name, *shapes[name]) for name in INPUTS}


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
    """V_next (n_v,) of ``A (v_next - v) = impulse`` in the rows that are free, and 0 in the locked ones."""
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
    for joint, lower, upper in limits.bounded_joints(model.robot.joints, model.robot.limits):
        at = joint.position(q)
        beyond = ca.fmin(at - lower, 0) + ca.fmax(at - upper, 0)
        touching = beyond != 0
        force[joint.idx_v] = ca.if_else(touching, -k * beyond - (d + dt * k) * v[joint.idx_v], 0)
        slope[joint.idx_v] = ca.if_else(touching, d + dt * k, 0)
    return force, slope


def _contact(model: StepModel, q: ca.SX, v: ca.SX, floor_z: ca.SX, normal: ca.SX, dt: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Vertical force [N] per point, the generalized force (n_v,) [N, N m] of all, and what they add to G (n_v, n_v)."""
    n_v = model.robot.n_v
    total, slope = ca.SX.zeros(n_v), ca.SX(n_v, n_v)
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


# A control period of the physical plant: several steps as one function, called through memory that is written to in place.


@lru_cache(maxsize=16)
def period_function(step: ca.Function, n_steps: int) -> ca.Function:
    """``n_steps`` calls of `step_function` as one Function, whose dt [s] is that of all of them and whose result is one column.

    The column holds q, v, thrust, thruster_energy and joint_energy at the end, then torque and contact of the last step, then
    a (n_v,) [m/s2, rad/s2]: the mean acceleration, as an accelerometer would integrate it. n_steps is at least 1. The
    graph is walked by CasADi; what takes time is the step, compiled once for periods of any length.
    """
    inputs = {step.name_in(i): ca.MX.sym(step.name_in(i), *step.size_in(i)) for i in range(step.n_in())}
    carried, held = list(inputs.values())[: len(CARRIED)], list(inputs.values())[len(CARRIED) :]
    dt = held.pop()
    results: list[ca.MX] = []
    for _ in range(n_steps):
        results = list(step(*carried, *held, dt / n_steps))
        carried = results[: len(CARRIED)]
    a = (carried[1] - inputs["v"]) / dt
    return ca.Function("plant_period", [*inputs.values()], [ca.vertcat(*results, a)], [*inputs], ["after"])


class StepSequence:
    """`period_function` over fixed memory: `given` is written to, and a call gives a fresh result.

    Not for use from two threads at once.
    """

    __slots__ = ("_period", "_result", "carried", "given")

    def __init__(self, step: ca.Function, n_steps: int) -> None:
        """step: `step_function`, compiled or not. n_steps: at least 1, in a period. Raises `InvalidInput` for fewer."""
        if n_steps < 1:
            raise InvalidInput(f"{n_steps} steps in a period; give 1 or more")
        function = period_function(step, n_steps)
        memory, self.given = _memory(function)
        """Arrays by name: (n,) views, and those of `TABLES` as (columns, rows), all to be written to."""
        self.carried = memory[: parts_of(step)["torque"].start]
        """(n_carried,) view of the inputs that the first results are: for the next period."""
        self._result = np.zeros(function.numel_out(0))
        self._period = buffered.BoundFunction(function, [view.T for view in self.given.values()], [self._result])

    def __call__(self) -> np.ndarray:
        """The column (n,) [units of its parts] after one period of what is `given`."""
        self._period.evaluate()
        return self._result.copy()


def parts_of(step: ca.Function) -> dict[str, slice]:
    """Where each result of `period_function` stands in its column, by name."""
    names = [step.name_out(i).removesuffix("_next") for i in range(step.n_out())] + ["a"]
    ends = np.cumsum([*(step.numel_out(i) for i in range(step.n_out())), step.numel_out("v_next")]).tolist()
    return {name: slice(begin, end) for name, begin, end in zip(names, [0, *ends], ends, strict=False)}


def _memory(function: ca.Function) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
    """One block for all inputs and, by name, the views of it."""
    sizes = [function.size_in(i) for i in range(function.n_in())]
    ends = np.cumsum([rows * columns for rows, columns in sizes]).tolist()
    block, views = np.zeros(ends[-1]), {}
    for i, (rows, columns) in enumerate(sizes):
        part, name = block[ends[i] - rows * columns : ends[i]], function.name_in(i)
        views[name] = part.reshape(columns, rows) if name in TABLES else part  # CasADi reads by columns
    return block, views
