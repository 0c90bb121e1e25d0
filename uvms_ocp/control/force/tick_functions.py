"""Smooth parts of a tick of the force layer: three CasADi functions on columns of numbers.

`observe_function` finds the disturbance, `want_function` the force for the reference, and `follow_function` the commands of
thrusters and motors, with the allocation of thrust before it. The state of a tick goes in and comes out; nothing else is
remembered.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from enum import IntEnum
from functools import partial
from typing import Annotated, Any, TypeVar

import casadi as ca

from uvms_ocp.codegen.elementwise import Array
from uvms_ocp.codegen.kernel_layout import Layout, Sized, declared_sizes, view
from uvms_ocp.control.faults.verdicts import (
    ActuatorHealthTuning,
    FilteredCommands,
    ResidualFilter,
    ThrusterEffectiveness,
)
from uvms_ocp.control.force.allocation import ThrusterLag
from uvms_ocp.control.force.observer import ObserverLaw, ObserverState, limited
from uvms_ocp.control.force.velocity_law import VelocityLaw
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.symbolic_bodies import sparse
from uvms_ocp.robot.thrusters import thruster_matrix

# What a tick of the force layer is given, knows, wants and tells: named parts of columns of numbers.

Parts = TypeVar("Parts", bound=Layout)


class MonitorStep(IntEnum):
    """Of the monitor of actuators."""

    PAUSED = 0
    """What is measured is not to be trusted."""
    TAKES_IN = 1
    """What was asked."""
    DUE = 2
    """For a look, besides."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ForceInputs(Layout):
    """What a tick is given."""

    q: Annotated[Array, Sized("n_q")]
    """(n_q,) [m, rad] measured."""
    v: Annotated[Array, Sized("n_v")]
    """(n_v,) [m/s, rad/s] measured."""
    reference: Annotated[Array, Sized("n_v")]
    """(n_v,) [m/s, rad/s] velocity that is asked for."""
    feedback: Annotated[Array, Sized(1)]
    """(1,) share of their bandwidth that the loops of the vehicle come to."""
    joint_feedback: Annotated[Array, Sized(1)]
    """(1,) the same of the joints."""
    hold: Annotated[Array, Sized(1)]
    """(1,) 1: the vehicle's velocity is not to be trusted."""
    stop: Annotated[Array, Sized(1)]
    """(1,) 1: no thrust."""
    joints: Annotated[Array, Sized(1)]
    """(1,) 1: the joints' velocities are to be trusted."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ForceState(Layout):
    """What it remembers: all of it 0 before the first tick, but the share, which is 1."""

    thrust: Annotated[Array, Sized("n_thrusters")]
    """(n_thrusters,) [N] modelled, of thrusters that all follow their commands."""
    torque: Annotated[Array, Sized("n_joints")]
    """(n_joints,) [N m or N] last asked."""
    estimate: Annotated[Array, Sized("n_v")]
    """(n_v,) [N, N m] disturbance."""
    lead: Annotated[Array, Sized("n_v")]
    """(n_v,) [N, N m] as `ObserverState.lead`."""
    v_hat: Annotated[Array, Sized("n_v")]
    """(n_v,) [m/s, rad/s] that the observer expects."""
    follows: Annotated[Array, Sized(1)]
    """(1,) 1 where v_hat is known."""
    share: Annotated[Array, Sized("n_v")]
    """(n_v,) of the bandwidth."""
    integral: Annotated[Array, Sized("n_v")]
    """(n_v,) [m, rad] of the error."""
    before: Annotated[Array, Sized("n_v")]
    """(n_v,) [m/s, rad/s] the last reference."""
    asked: Annotated[Array, Sized("n_thrusters")]
    """(n_thrusters,) [N] as `Asked.thrust`."""
    way: Annotated[Array, Sized("n_v")]
    """(n_v,) [m/s, rad/s] as `Asked.way`."""
    ticks: Annotated[Array, Sized(1)]
    """(1,) as `Asked.ticks`."""
    watch: Annotated[Array, Sized(1)]
    """(1,) a `Watch`."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class DesiredForce(Layout):
    """What it wants, before thrusters are looked at."""

    error: Annotated[Array, Sized("n_v")]
    """(n_v,) [m/s, rad/s] of the velocity, 0 where that is not to be trusted."""
    force: Annotated[Array, Sized("n_v")]
    """(n_v,) [N, N m]"""
    wrench: Annotated[Array, Sized(6)]
    """(6,) [N, N m] of it, of thrusters."""
    torque: Annotated[Array, Sized("n_joints")]
    """(n_joints,) [N m or N] of it, inside the limits."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class AllocatedThrust(Layout):
    """What thrusters make of it, as `AllocationResult`."""

    thrust: Annotated[Array, Sized("n_thrusters")]
    """(n_thrusters,) [N]"""
    reached: Annotated[Array, Sized(6)]
    """(6,) [N, N m]"""
    unreachable: Annotated[Array, Sized(6)]
    """(6,) [N, N m]"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ForceOutputs(Layout):
    """What it tells."""

    command: Annotated[Array, Sized("n_thrusters")]
    """(n_thrusters,) [N] asked of the thrusters."""
    torque: Annotated[Array, Sized("n_joints")]
    """(n_joints,) [N m or N] asked of the joint motors."""
    disturbance: Annotated[Array, Sized("n_v")]
    """(n_v,) [N, N m]"""
    vehicle_force: Annotated[Array, Sized("n_vehicle")]
    """(n_vehicle,) [N, N m] wanted of the thrusters."""
    unreachable: Annotated[Array, Sized(6)]
    """(6,) [N, N m] of that."""
    push: Annotated[Array, Sized(1)]
    """(1,) upward part of the disturbance, as a share of the largest lift of the thrusters."""


def column_sizes(robot: Robot) -> dict[str, int]:
    """Sizes that parts are declared with, by name."""
    return {
        "n_q": robot.n_q,
        "n_v": robot.n_v,
        "n_vehicle": robot.n_vehicle,
        "n_joints": robot.n_joints,
        "n_thrusters": len(robot.description.thrusters),
    }


def column_places(parts: type[Layout], sizes: Mapping[str, int]) -> dict[str, slice]:
    """Where each part of a column is, by its name. As in memory, there is room for one number where there is none."""
    places, at = {}, 0
    for name, size in declared_sizes(parts, sizes).items():
        places[name] = slice(at, at + size)
        at += max(1, size)
    return places


def size_of(parts: type[Layout], sizes: Mapping[str, int]) -> int:
    """Of the whole column."""
    return sum(max(1, size) for size in declared_sizes(parts, sizes).values())


def parts_of(parts: type[Parts], sizes: Mapping[str, int], column: Array) -> Parts:
    """Slices of a column (n,) [any] of expressions."""
    return parts(**{name: column[place] for name, place in column_places(parts, sizes).items()})


def views_of(parts: type[Parts], sizes: Mapping[str, int], memory: Any) -> Parts:
    """Arrays of numbers on the memory of a column."""
    declared = declared_sizes(parts, sizes).items()
    return parts(**{name: view(getattr(memory, name))[:size] for name, size in declared})


def column_of(parts: Any) -> ca.SX:
    """All parts, which are expressions, one below the other."""
    columns = [getattr(parts, field.name) for field in fields(parts)]
    return ca.densify(ca.vertcat(*(column if column.numel() else ca.SX(1, 1) for column in columns)))


# A tick of the force layer as three CasADi functions of columns, with the allocation of thrust before the last of them.
#
# `observe_function` finds what pushes the robot, `want_function` the force for the reference, and `follow_function` what is asked
# of thrusters and motors. What a tick knows goes in and comes out; nothing else is remembered.

_EASE = 1.0  # [s] in which the bandwidth of the velocity loop changes
_FULL = 0.95  # share of its bandwidth that the observer needs for its findings to be judged


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ForceLaws:
    """Of one robot."""

    robot: Robot
    velocity: VelocityLaw
    lag: ThrusterLag
    lift: float
    """[N] of all thrusters at most."""
    observer: ObserverLaw | None = None
    residual_filter: ResidualFilter | None = None
    """Of the monitor of actuators, where there is one."""
    search: ActuatorHealthTuning | None = None
    """For faulty thrusters and joints, with what is taken in; `None` for none."""

    @property
    def sizes(self) -> dict[str, int]:
        """As `sizes_of`."""
        return column_sizes(self.robot)

    @property
    def matrix(self) -> ca.DM:
        """Of the thrusters (6, n_thrusters) [-, m]."""
        return sparse(thruster_matrix(self.robot))


def observe_function(laws: ForceLaws) -> ca.Function:
    """Function ``given, effect, known -> now``: what it knows once it has looked, but for what it asks in this tick."""
    x, (given, effect, known) = _symbols(laws, given=ForceInputs, effect=ThrusterEffectiveness, known=ForceState)
    gain = min(1.0, laws.velocity.dt / _EASE)
    share = known.share + gain * (_by_part(laws, given.feedback, given.joint_feedback) - known.share)
    integral = _by_part(laws, ca.if_else(given.stop, 0.0, known.integral), known.integral)
    now = replace(known, share=share, integral=integral)
    now = now if laws.observer is None else _observed(laws, laws.observer, given, effect, now)
    now = now if laws.residual_filter is None else _taken_in(laws, laws.residual_filter, given, now)
    return ca.Function("observe", list(x.values()), [ca.cse(column_of(now))], list(x), ["now"])


def want_function(laws: ForceLaws) -> ca.Function:
    """Function ``given, now -> wanted``."""
    x, (given, now) = _symbols(laws, given=ForceInputs, now=ForceState)
    trusted = _by_part(laws, 1.0 - given.hold, given.joints)
    error = ca.if_else(trusted, given.reference - given.v, 0.0)
    tau = laws.velocity.force(given.q, given.reference, now.before, error, now.integral, now.share) - now.estimate
    force = _by_part(laws, ca.if_else(given.stop, 0.0, tau), tau)
    n = laws.robot.n_vehicle
    wanted = DesiredForce(
        error=error,
        force=force,
        wrench=ca.vertcat(force[:n], ca.SX.zeros(6 - n)),
        torque=limited(force[n:], laws.robot.limits.effort),
    )
    return ca.Function("want", list(x.values()), [ca.cse(column_of(wanted))], list(x), ["wanted"])


def follow_function(laws: ForceLaws) -> ca.Function:
    """Function ``given, effect, now, wanted, allocated -> known, told``, known for the next tick."""
    kinds: dict[str, type[Any]] = {
        "given": ForceInputs,
        "effect": ThrusterEffectiveness,
        "now": ForceState,
        "wanted": DesiredForce,
    }
    x, (given, effect, now, wanted, allocated) = _symbols(laws, **kinds, allocated=AllocatedThrust)
    n = laws.robot.n_vehicle
    reached = ca.vertcat(allocated.reached[:n], wanted.torque)
    command = laws.lag.command(now.thrust, effect.asked(allocated.thrust), 1.0 - given.stop)
    known = replace(
        now,
        thrust=laws.lag.after(now.thrust, command),
        torque=wanted.torque,
        integral=laws.velocity.integrated(now.integral, wanted.error, wanted.force, reached),
        before=given.reference,
    )
    told = ForceOutputs(
        command=command,
        torque=wanted.torque,
        disturbance=now.estimate,
        vehicle_force=wanted.force[:n],
        unreachable=allocated.unreachable,
        push=ca.dot(_up(given.q), now.estimate[:3]) / laws.lift if n else ca.SX(1, 1),
    )
    return ca.Function("follow", list(x.values()), [column_of(known), column_of(told)], list(x), ["known", "told"])


def _observed(
    laws: ForceLaws, law: ObserverLaw, given: ForceInputs, effect: ThrusterEffectiveness, now: ForceState
) -> ForceState:
    """Where the velocity is not to be trusted the estimate is kept, or set to zero where the robot is stopped."""
    wrench = ca.mtimes(laws.matrix, effect.given(now.thrust))
    force = ca.vertcat(wrench[: laws.robot.n_vehicle], now.torque)
    before = ObserverState(estimate=now.estimate, lead=now.lead, v_hat=now.v_hat, follows=now.follows)
    found = law.after(before, laws.velocity.dynamics, given.q, given.v, force, now.share)
    held = partial(ca.if_else, given.hold)
    return replace(
        now,
        estimate=held(ca.if_else(given.stop, 0.0, now.estimate), found.estimate),
        lead=held(now.lead, found.lead),
        v_hat=held(now.v_hat, found.v_hat),
        follows=held(0.0, found.follows),
    )


def _taken_in(laws: ForceLaws, residual_filter: ResidualFilter, given: ForceInputs, now: ForceState) -> ForceState:
    """While everything is fed back with nearly the full bandwidth."""
    joints = given.joints if laws.robot.n_joints else 1.0
    watches = ca.logic_and(ca.logic_and(1.0 - given.hold, joints), now.share[0] >= _FULL)
    after = residual_filter.after(
        FilteredCommands(thrust=now.asked, way=now.way, ticks=now.ticks), now.thrust, now.before
    )
    when = partial(ca.if_else, watches)
    status = ca.if_else(after.ticks == 0.0, float(MonitorStep.DUE), float(MonitorStep.TAKES_IN))
    return replace(
        now,
        asked=when(after.thrust, now.asked),
        way=when(after.way, now.way),
        ticks=when(after.ticks, now.ticks),
        watch=when(status, float(MonitorStep.PAUSED)),
    )


def _symbols(laws: ForceLaws, **kinds: type[Any]) -> tuple[dict[str, ca.SX], tuple[Any, ...]]:
    """Columns by name, and the parts of each."""
    columns, parts = {}, []
    for name, kind in kinds.items():
        columns[name] = ca.SX.sym(name, size_of(kind, laws.sizes))
        parts.append(parts_of(kind, laws.sizes, columns[name]))
    return columns, tuple(parts)


def _by_part(laws: ForceLaws, vehicle: ca.SX, joints: ca.SX) -> ca.SX:
    """(n_v,) of the axes of the vehicle the one, of the joints the other; either may be one number for all."""
    n_v, n = laws.robot.n_v, laws.robot.n_vehicle
    vehicle, joints = (ca.repmat(part, n_v) if part.is_scalar() else part for part in (vehicle, joints))
    return ca.vertcat(vehicle[:n], joints[n:])


def _up(q: ca.SX) -> ca.SX:
    """Z of W in B (3,), of the quaternion xyzw in q."""
    x, y, z, w = ca.vertsplit(q[3:7])
    return ca.vertcat(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
