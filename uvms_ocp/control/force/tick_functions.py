"""Smooth parts of a tick of the force layer: six CasADi functions on columns of numbers.

`transfer_function` changes the bandwidth, `carry_function` what is borne at rest, `weigh_function`
finds a load, `observe_function` the disturbance, `control_function` the force for the reference, and
`command_function` the commands of thrusters and motors, with the allocation of thrust before it. The
state of a tick goes in and comes out; nothing else is remembered.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from enum import IntEnum
from functools import partial
from typing import Annotated, Any, TypeVar

import casadi as ca
import numpy as np

from uvms_ocp.checks import replace_with_symbols
from uvms_ocp.codegen.casadi_code import with_numbers
from uvms_ocp.codegen.elementwise import Array
from uvms_ocp.codegen.kernel_layout import Layout, Sized, declared_sizes
from uvms_ocp.control.faults.residual_filter import FilteredCommands, ResidualFilter
from uvms_ocp.control.faults.tuning import ActuatorHealthTuning
from uvms_ocp.control.faults.verdicts import ThrusterEffectiveness
from uvms_ocp.control.force.observer import ObserverLaw, ObserverState, limited
from uvms_ocp.control.force.thruster_lag import ThrusterLag
from uvms_ocp.control.force.velocity_law import BandwidthDerating, VelocityLaw
from uvms_ocp.control.payload import load_force
from uvms_ocp.robot import Robot, symbolic_bodies, thruster_matrix, thrusters
from uvms_ocp.robot.dimensions import Dimensions, dimensions_of
from uvms_ocp.robot.electrical_power import electrical_power, joint_power, power_law
from uvms_ocp.robot.size import size as size_of

Parts = TypeVar("Parts", bound=Layout)

_EASE = 1.0  # [s] in which the bandwidth of the velocity loop changes
# share, of the bandwidth that the sensors allow, that the observer needs for its findings to be
# judged
_FULL = 0.95
_LIFT = 0.5  # share of what a current pushes a vehicle sideways by, by which it lifts one that is tilted, at most
_NO_FORCE = 1e-12  # [N2] nothing is divided by less


class MonitorStep(IntEnum):
    """State of the actuator monitor in a tick."""

    PAUSED = 0
    """The estimate is not trusted."""
    TAKES_IN = 1
    """Filtering commands."""
    DUE = 2
    """For a look, besides."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ForceInputs(Layout):
    """Inputs of a tick."""

    q: Annotated[Array, Sized("n_q")]
    """(n_q,) [m, rad] measured."""
    q_before: Annotated[Array, Sized("n_q")]
    """(n_q,) [m, rad] as now, with the joints as measured in the tick before."""
    v: Annotated[Array, Sized("n_v")]
    """(n_v,) [m/s, rad/s] measured."""
    reference: Annotated[Array, Sized("n_v")]
    """(n_v,) [m/s, rad/s] velocity that is asked for."""
    feedback: Annotated[Array, Sized(1)]
    """(1,) share of their bandwidth that the loops of the vehicle come to."""
    joint_feedback: Annotated[Array, Sized(1)]
    """(1,) share of their bandwidth that the loops of the joints come to."""
    hold: Annotated[Array, Sized(1)]
    """(1,) 1: the vehicle's velocity is not to be trusted."""
    turning: Annotated[Array, Sized(1)]
    """(1,) 1: its angular velocity is to be trusted all the same."""
    stop: Annotated[Array, Sized(1)]
    """(1,) 1: no thrust."""
    joints: Annotated[Array, Sized(1)]
    """(1,) 1: the joints' velocities are to be trusted."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ForceState(Layout):
    """State carried from tick to tick: all of it 0 before the first one, but the share, which is
    1.
    """

    thrust: Annotated[Array, Sized("n_thrusters")]
    """(n_thrusters,) [N] modelled, of thrusters that all follow their commands."""
    torque: Annotated[Array, Sized("n_joints")]
    """(n_joints,) [N m or N] last asked."""
    estimate: Annotated[Array, Sized("n_v")]
    """(n_v,) [N, N m] disturbance."""
    beyond: Annotated[Array, Sized("n_v")]
    """(n_v,) [N, N m] what the estimate of locked joints would be more without its limit."""
    lead: Annotated[Array, Sized("n_v")]
    """(n_v,) [N, N m] from the estimate to one with one lag less, and so more noise."""
    v_hat: Annotated[Array, Sized("n_v")]
    """(n_v,) [m/s, rad/s] that the observer expects."""
    follows: Annotated[Array, Sized(1)]
    """(1,) 1 where v_hat is known."""
    share: Annotated[Array, Sized("n_v")]
    """(n_v,) share of the bandwidth that each axis has."""
    integral: Annotated[Array, Sized("n_v")]
    """(n_v,) [m, rad] integral of the velocity error."""
    before: Annotated[Array, Sized("n_v")]
    """(n_v,) [m/s, rad/s] reference of the tick before."""
    asked: Annotated[Array, Sized("n_thrusters")]
    """(n_thrusters,) [N] commanded thrust, filtered as the observer filters the residual."""
    way: Annotated[Array, Sized("n_v")]
    """(n_v,) [m/s, rad/s] sum of the reference velocities since the last look of fault detection.
    """
    ticks: Annotated[Array, Sized(1)]
    """(1,) ticks since the last look of fault detection."""
    watch: Annotated[Array, Sized(1)]
    """(1,) a `MonitorStep`."""
    spent: Annotated[Array, Sized(1)]
    """(1,) [J] electrical, of thrusters as modelled and of joints as asked; NaN where a thruster's
    power is not given.
    """


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class DesiredForce(Layout):
    """Force for the reference velocity, before it is allocated to thrusters."""

    error: Annotated[Array, Sized("n_v")]
    """(n_v,) [m/s, rad/s] of the velocity, 0 where that is not to be trusted."""
    force: Annotated[Array, Sized("n_v")]
    """(n_v,) [N, N m]"""
    wrench: Annotated[Array, Sized(6)]
    """(6,) [N, N m] part of the force that the thrusters are to give."""
    torque: Annotated[Array, Sized("n_joints")]
    """(n_joints,) [N m or N] part of the force that the joint motors are to give, inside their
    limits.
    """


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class AllocatedThrust(Layout):
    """Thrust allocated to the desired force, and how much of its wrench that reaches."""

    thrust: Annotated[Array, Sized("n_thrusters")]
    """(n_thrusters,) [N]"""
    reached: Annotated[Array, Sized(6)]
    """(6,) [N, N m] as far as the limits allow: what a dead zone holds back winds up until it is
    passed.
    """
    unreachable: Annotated[Array, Sized(6)]
    """(6,) [N, N m]"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ForceOutputs(Layout):
    """Outputs of a tick."""

    command: Annotated[Array, Sized("n_thrusters")]
    """(n_thrusters,) [N] asked of the thrusters."""
    torque: Annotated[Array, Sized("n_joints")]
    """(n_joints,) [N m or N] asked of the joint motors."""
    disturbance: Annotated[Array, Sized("n_v")]
    """(n_v,) [N, N m]"""
    vehicle_force: Annotated[Array, Sized("n_vehicle")]
    """(n_vehicle,) [N, N m] desired of the thrusters."""
    unreachable: Annotated[Array, Sized(6)]
    """(6,) [N, N m] part of it that the thrusters cannot give."""
    push: Annotated[Array, Sized(1)]
    """(1,) upward part of the disturbance, as a share of the largest lift of the thrusters; 0 where
    none lifts.
    """


def column_places(parts: type[Layout], dimensions: Dimensions) -> dict[str, slice]:
    """Return the slice of each part of a column, by name. As in memory, an empty part takes one
    number.
    """
    places = {}
    at = 0
    for name, size in declared_sizes(parts, dimensions).items():
        places[name] = slice(at, at + size)
        at += max(1, size)
    return places


def parts_of(parts: type[Parts], dimensions: Dimensions, column: Array) -> Parts:
    """Split a column (n,) of expressions into its parts."""
    return parts(
        **{name: column[place] for name, place in column_places(parts, dimensions).items()}
    )


def column_of(parts: Any) -> ca.SX:
    """Stack all parts, which are expressions, into one column."""
    columns = list[ca.SX]()
    for part in fields(parts):
        column = getattr(parts, part.name)
        # C knows no empty array.
        columns.append(column if column.numel() else ca.SX(1, 1))
    return ca.densify(ca.vertcat(*columns))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ForceLaws:
    """Laws of the force layer of one robot."""

    robot: Robot
    velocity: VelocityLaw
    lag: ThrusterLag
    lift: float
    """[N] of all thrusters at most; 0 where none lifts, and no push is measured by it."""
    derating: BandwidthDerating = field(default_factory=BandwidthDerating)
    """Derating of the bandwidths for the dead time of the sensors."""
    measures_joint_rates: bool = False
    """Sensors of their own tell the joints' rates."""
    observer: ObserverLaw | None = None
    residual_filter: ResidualFilter | None = None
    """Filter of the actuator monitor, where there is one."""
    search: ActuatorHealthTuning | None = None
    """Tuning of the search for faulty thrusters and joints; `None` searches for none."""
    gains: ca.SX = field(default_factory=partial(ca.SX, 0, 1))
    """Gains that are symbols, the last input of functions that are made of these laws; none where
    all are numbers.
    """

    @property
    def dimensions(self) -> Dimensions:
        """Dimensions of the robot, which columns are declared with."""
        return dimensions_of(self.robot)

    @property
    def matrix(self) -> ca.DM:
        """Thruster matrix (6, n_thrusters) [-, m]."""
        return symbolic_bodies.sparse(thruster_matrix(self.robot))


def with_gains(make: Callable[[ForceLaws], ca.Function], laws: ForceLaws) -> ca.Function:
    """Make a function of the laws whose code is the same for all gains, which become its last
    input.
    """
    velocity = laws.velocity
    observer = laws.observer
    values = [velocity.K_p, velocity.reset]
    if observer is not None:
        values.append(observer.bandwidth)
    gains = ca.SX.sym("gains", laws.robot.n_v, len(values))
    K_p, reset, *bandwidth = ca.horzsplit(gains)
    if observer is not None:
        observer = replace_with_symbols(observer, bandwidth=bandwidth[0])
    symbolic = replace(
        laws,
        velocity=replace(velocity, K_p=K_p, reset=reset),
        observer=observer,
        gains=ca.vec(gains),
    )
    return with_numbers(make(symbolic), np.concatenate(values).tolist())


def transfer_function(laws: ForceLaws) -> ca.Function:
    """Make ``inputs, state -> transferred``: shares of the bandwidth a tick nearer to what is
    asked, without a bump.
    """
    x, (inputs, state) = _symbols(laws, inputs=ForceInputs, state=ForceState)
    gain = min(1.0, laws.velocity.dt / _EASE)
    share = state.share + gain * (
        _by_part(laws, inputs.feedback, inputs.joint_feedback) - state.share
    )
    integral = laws.velocity.bumpless(
        inputs.q, inputs.reference, state.integral, share, state.share
    )
    transferred = column_of(replace(state, share=share, integral=integral))
    return ca.Function(
        "transfer", list(x.values()), [ca.cse(transferred)], list(x), ["transferred"]
    )


def carry_function(laws: ForceLaws) -> ca.Function:
    """Make ``inputs, state -> estimate, beyond``: the disturbance with which motors go on to give the
    torque that holds joints at rest, though their measured posture has changed, and what it would be
    more without its limit. A posture that is measured again as it was then changes nothing.
    """
    x, (inputs, state) = _symbols(laws, inputs=ForceInputs, state=ForceState)
    estimate, beyond = state.estimate, state.beyond
    if laws.observer is not None:
        dynamics = laws.velocity.dynamics
        rest = ca.SX(laws.robot.n_v, 1)
        still = ca.SX(3, len(dynamics.links))
        weights = [dynamics.bias_force(q, rest, still, still) for q in (inputs.q, inputs.q_before)]
        unlimited = estimate + beyond + weights[0] - weights[1]
        carried = limited(unlimited, laws.observer.limit)
        estimate = _by_part(laws, estimate, carried)
        beyond = _by_part(laws, ca.SX(0.0), unlimited - carried)
    outputs = [ca.densify(estimate), ca.densify(beyond)]
    return ca.Function("carry", list(x.values()), ca.cse(outputs), list(x), ["estimate", "beyond"])


def weigh_function(laws: ForceLaws) -> ca.Function:
    """Make ``inputs, state -> weighed, explained``: the disturbance that a load at one of the tools makes
    of joints, by its weight that the vehicle bears, and the share of what the vehicle bears that it
    explains.

    A weight w at a tool is a generalized force ``w J.T down``. Its part on the vehicle is fitted to the
    observed disturbance along the vertical and about horizontal axes, in N and N m over the size of the
    robot: currents push sideways. They lift a vehicle that is tilted, too, so that nothing is explained by
    a weight that is small beside what pushes sideways. Of several tools the one is taken that explains most. Joints that do not
    carry it keep their disturbance; without a vehicle, or a tool, nothing is explained.
    """
    x, (inputs, state) = _symbols(laws, inputs=ForceInputs, state=ForceState)
    weighed = state.estimate
    explained = ca.SX(0.0)
    n = laws.robot.n_vehicle
    if laws.observer is not None and n and laws.robot.n_joints:
        body = laws.velocity.dynamics
        up = _up(inputs.q)
        scale = ca.DM(np.repeat([1.0, 1.0 / size_of(laws.robot.model)], 3))
        borne = scale * _by_weight(up, state.estimate[:n], laws.observer.limit[:n])
        push = state.estimate[:3]
        sideways = ca.norm_2(push - up * ca.dot(up, push))
        for tool in laws.robot.tools:
            force = load_force(body, inputs.q, ca.SX(3, 1), tool)[:, 0]
            pattern = scale * _by_weight(up, ca.densify(force[:n]), laws.observer.limit[:n])
            weight = ca.dot(pattern, borne) / (ca.dot(pattern, pattern) + _NO_FORCE)
            total = ca.sumsqr(borne)
            share = (total - ca.sumsqr(borne - weight * pattern)) / (total + _NO_FORCE)
            share = ca.if_else(ca.fabs(weight) > _LIFT * sideways, share, 0.0)
            borne_by_joints = limited(weight * ca.densify(force), laws.observer.limit)
            by_tool = ca.SX(state.estimate)
            for k in range(n, laws.robot.n_v):
                if force[k].nnz():
                    by_tool[k] = borne_by_joints[k]
            weighed = ca.if_else(share > explained, by_tool, weighed)
            explained = ca.fmax(share, explained)
    outputs = [ca.densify(weighed), ca.densify(explained)]
    return ca.Function(
        "weigh", list(x.values()), ca.cse(outputs), list(x), ["weighed", "explained"]
    )


def _by_weight(up: ca.SX, wrench: ca.SX, limit: np.ndarray) -> ca.SX:
    """Return the parts of a wrench (6,) [N, N m] that weights make: the vertical force, and moments about
    horizontal axes; 0 along axes that bear none. up (3,): z axis of W in B.
    """
    bears = ca.DM((limit > 0.0).astype(float))
    vertical = up @ (up.T @ wrench[:3])
    moment = wrench[3:] - up @ (up.T @ wrench[3:])
    return bears * ca.vertcat(vertical, moment)


def observe_function(laws: ForceLaws) -> ca.Function:
    """Make ``inputs, effectiveness, state -> observed``: the state after the observer, before this
    tick's commands.
    """
    x, (inputs, effectiveness, state) = _symbols(
        laws, inputs=ForceInputs, effectiveness=ThrusterEffectiveness, state=ForceState
    )
    observed = replace(
        state, integral=_by_part(laws, ca.if_else(inputs.stop, 0.0, state.integral), state.integral)
    )
    if laws.observer is not None:
        observed = _observed(laws, laws.observer, inputs, effectiveness, observed)
    if laws.residual_filter is not None:
        observed = _taken_in(laws, laws.residual_filter, inputs, observed)
    return ca.Function(
        "observe", list(x.values()), [ca.cse(column_of(observed))], list(x), ["observed"]
    )


def control_function(laws: ForceLaws) -> ca.Function:
    """Make ``inputs, observed -> desired``: the force for the reference."""
    x, (inputs, observed) = _symbols(laws, inputs=ForceInputs, observed=ForceState)
    moves = 1.0 - inputs.hold
    turns = ca.fmax(moves, inputs.turning)
    trusted = _by_part(laws, ca.vertcat(moves, moves, moves, turns, turns, turns), inputs.joints)
    # Joints meet a reference in the tick that it is given for: now they are to be at the one before.
    # Taken for an error, the difference would drive them beyond a reference that ends to grow.
    due = _by_part(laws, inputs.reference, observed.before)
    error = ca.if_else(trusted, due - inputs.v, 0.0)
    before = ca.if_else(
        _by_part(laws, ca.SX(1.0), inputs.joints), observed.before, inputs.reference
    )  # brakes stop at once
    motions, measured = map(symbolic_bodies.sparse, thrusters.free_motions(laws.robot))
    error = error - motions @ (measured @ error)
    before = before + motions @ (measured @ (inputs.reference - before))
    tau = (
        laws.velocity.force(
            inputs.q, inputs.reference, before, error, observed.integral, observed.share
        )
        - observed.estimate
    )
    M = laws.velocity.dynamics.mass_matrix(inputs.q)
    tau = thrusters.without_free_motions(laws.robot, M, tau)
    force = _by_part(laws, ca.if_else(inputs.stop, 0.0, tau), tau)
    n = laws.robot.n_vehicle
    desired = DesiredForce(
        error=error,
        force=force,
        wrench=ca.vertcat(force[:n, :], ca.SX.zeros(6 - n)),
        torque=limited(force[n:, :], laws.robot.limits.effort),
    )
    return ca.Function(
        "control", list(x.values()), [ca.cse(column_of(desired))], list(x), ["desired"]
    )


def command_function(laws: ForceLaws) -> ca.Function:
    """Make ``inputs, effectiveness, observed, desired, allocated -> state, outputs``, with the
    state of the next tick.
    """
    kinds: dict[str, type[Any]] = {"inputs": ForceInputs, "effectiveness": ThrusterEffectiveness}
    kinds |= {"observed": ForceState, "desired": DesiredForce, "allocated": AllocatedThrust}
    x, (inputs, effectiveness, observed, desired, allocated) = _symbols(laws, **kinds)
    n = laws.robot.n_vehicle
    command = laws.lag.command(
        observed.thrust, effectiveness.asked(allocated.thrust), 1.0 - inputs.stop
    )
    wanted_torque = _torque_beside_thrust(laws, inputs, effectiveness, observed, desired, command)
    torque = limited(wanted_torque, laws.robot.limits.effort)
    reached_torque = desired.force[n:, :] - (wanted_torque - torque)
    reached = ca.vertcat(allocated.reached[:n], reached_torque)
    thrust = laws.lag.after(observed.thrust, command)
    power = electrical_power((observed.thrust + thrust) / 2.0, *power_law(laws.robot))
    drives = joint_power(torque, inputs.reference[n:, :], laws.robot.description.joint_efficiency)
    state = replace(
        observed,
        thrust=thrust,
        torque=torque,
        integral=laws.velocity.integrated(observed.integral, desired.error, desired.force, reached),
        before=inputs.reference,
        spent=observed.spent + laws.velocity.dt * (ca.sum1(power) + ca.sum1(drives)),
    )
    push = ca.SX(1, 1)
    if n and laws.lift > 0.0:
        push = ca.dot(_up(inputs.q), observed.estimate[:3]) / laws.lift
    outputs = ForceOutputs(
        command=command,
        torque=torque,
        disturbance=observed.estimate,
        vehicle_force=desired.force[:n, :],
        unreachable=allocated.unreachable,
        push=push,
    )
    return ca.Function(
        "command",
        list(x.values()),
        [column_of(state), column_of(outputs)],
        list(x),
        ["state", "outputs"],
    )


def _torque_beside_thrust(
    laws: ForceLaws,
    inputs: ForceInputs,
    effectiveness: ThrusterEffectiveness,
    observed: ForceState,
    desired: DesiredForce,
    command: ca.SX,
) -> ca.SX:
    """Return the torque (n_joints,) [N m or N] for the desired accelerations of the joints while
    the vehicle accelerates as its thrusters do push it.

    ``tau + M_jv M_vv^-1 (f - f_desired)``, with the mean f of what thrusters give in the tick that
    begins. Motors act at once, thrusters later than asked and within their limits: an arm would
    else be thrown by what the vehicle lacks.
    """
    n = laws.robot.n_vehicle
    torque = desired.force[n:, :]
    if not n or not laws.robot.n_joints:
        return torque
    mean_thrust = effectiveness.given(laws.lag.mean(observed.thrust, command))
    excess = ca.mtimes(laws.matrix, mean_thrust)[:n] - desired.force[:n, :]
    M = laws.velocity.dynamics.mass_matrix(inputs.q)
    D, L_transposed, order = ca.ldl(M[:n, :n], False)
    excess_acceleration = ca.ldl_solve(excess, D, L_transposed, order)
    return torque + M[n:, :n] @ excess_acceleration


def _observed(
    laws: ForceLaws,
    law: ObserverLaw,
    inputs: ForceInputs,
    effectiveness: ThrusterEffectiveness,
    observed: ForceState,
) -> ForceState:
    """Update the observer; where the velocity is not trusted, keep the estimate, or zero it where
    the robot is stopped.

    Of joints that brakes lock it is kept too: what the brakes bear is no disturbance.
    Nor do rates tell, as they lock, what makes a joint fall: an encoder that runs away shows the same ones.
    """
    wrench = ca.mtimes(laws.matrix, effectiveness.given(observed.thrust))
    force = ca.vertcat(wrench[: laws.robot.n_vehicle], observed.torque)
    before = ObserverState(
        estimate=observed.estimate,
        lead=observed.lead,
        v_hat=observed.v_hat,
        follows=observed.follows,
    )
    updated = law.after(before, laws.velocity.dynamics, inputs.q, inputs.v, force, observed.share)
    choose = partial(ca.if_else, inputs.hold)
    kept_estimate = ca.if_else(inputs.stop, 0.0, observed.estimate)
    kept_beyond = ca.if_else(inputs.stop, 0.0, observed.beyond)
    estimate = choose(kept_estimate, updated.estimate)
    lead = choose(observed.lead, updated.lead)
    v_hat = choose(observed.v_hat, updated.v_hat)
    unless_locked = partial(ca.if_else, inputs.joints)
    return replace(
        observed,
        estimate=_by_part(laws, estimate, unless_locked(estimate, kept_estimate)),
        beyond=_by_part(laws, ca.SX(0.0), unless_locked(0.0, kept_beyond)),
        lead=_by_part(laws, lead, unless_locked(lead, observed.lead)),
        v_hat=_by_part(laws, v_hat, unless_locked(v_hat, inputs.v)),
        follows=choose(0.0, updated.follows),
    )


def _taken_in(
    laws: ForceLaws, residual_filter: ResidualFilter, inputs: ForceInputs, observed: ForceState
) -> ForceState:
    """Filter the commands for the monitor while everything is fed back with nearly the full
    bandwidth.
    """
    joints = inputs.joints if laws.robot.n_joints else 1.0
    is_fed_back = ca.logic_and(1.0 - inputs.hold, joints)
    has_bandwidth = observed.share[0] >= _FULL * laws.derating.vehicle
    watches = ca.logic_and(is_fed_back, has_bandwidth)
    before = FilteredCommands(thrust=observed.asked, way=observed.way, ticks=observed.ticks)
    after = residual_filter.after(before, observed.thrust, observed.before)
    when = partial(ca.if_else, watches)
    status = ca.if_else(after.ticks == 0.0, float(MonitorStep.DUE), float(MonitorStep.TAKES_IN))
    return replace(
        observed,
        asked=when(after.thrust, observed.asked),
        way=when(after.way, observed.way),
        ticks=when(after.ticks, observed.ticks),
        watch=when(status, float(MonitorStep.PAUSED)),
    )


def _symbols(laws: ForceLaws, **kinds: type[Any]) -> tuple[dict[str, ca.SX], tuple[Any, ...]]:
    """Return symbolic columns by name, and the parts of each."""
    columns = {}
    parts = []
    for name, kind in kinds.items():
        sizes = declared_sizes(kind, laws.dimensions).values()
        columns[name] = ca.SX.sym(name, sum(max(1, size) for size in sizes))
        parts.append(parts_of(kind, laws.dimensions, columns[name]))
    if laws.gains.numel():
        columns["gains"] = laws.gains
    return columns, tuple(parts)


def _by_part(laws: ForceLaws, vehicle: ca.SX, joints: ca.SX) -> ca.SX:
    """Join values of the vehicle's axes and of the joints to (n_v,); either may be one number for
    all.
    """
    n = laws.robot.n_vehicle
    if vehicle.is_scalar():
        vehicle = ca.repmat(vehicle, laws.robot.n_v)
    if joints.is_scalar():
        joints = ca.repmat(joints, laws.robot.n_v)
    # One entry, sliced without its other axis, would become a row.
    return ca.vertcat(vehicle[:n, :], joints[n:, :])


def _up(q: ca.SX) -> ca.SX:
    """Return the z axis of W in B (3,), from the quaternion xyzw in q."""
    x, y, z, w = ca.vertsplit(q[3:7])
    return ca.vertcat(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
