"""A tick of the force layer as three CasADi functions of columns, with the allocation of thrust before the last of them.

`observe_function` finds what pushes the robot, `want_function` the force for the reference, and `follow_function` what is asked
of thrusters and motors. What a tick knows goes in and comes out; nothing else is remembered.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import casadi as ca

from uvms_ocp.control.actuator_health.effect import Effect
from uvms_ocp.control.actuator_health.intake import Asked, Intake
from uvms_ocp.control.actuator_health.thresholds import ActuatorHealthTuning
from uvms_ocp.control.force.observer import Observed, ObserverLaw, limited
from uvms_ocp.control.force.thruster_lag import ThrusterLag
from uvms_ocp.control.force.tick_columns import (
    Allocated,
    Given,
    Known,
    Told,
    Wanted,
    Watch,
    column_of,
    parts_of,
    size_of,
    sizes_of,
)
from uvms_ocp.control.force.velocity_law import VelocityLaw
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.symbolic.joint_types import sparse
from uvms_ocp.model.thrusters import thruster_matrix

_EASE = 1.0  # [s] in which the bandwidth of the velocity loop changes
_FULL = 0.95  # share of its bandwidth that the observer needs for its findings to be judged


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TickLaws:
    """Of one robot."""

    robot: Robot
    velocity: VelocityLaw
    lag: ThrusterLag
    lift: float
    """[N] of all thrusters at most."""
    observer: ObserverLaw | None = None
    intake: Intake | None = None
    """Of the monitor of actuators, where there is one."""
    search: ActuatorHealthTuning | None = None
    """For faulty thrusters and joints, with what is taken in; `None` for none."""

    @property
    def sizes(self) -> dict[str, int]:
        """As `sizes_of`."""
        return sizes_of(self.robot)

    @property
    def matrix(self) -> ca.DM:
        """Of the thrusters (6, n_thrusters) [-, m]."""
        return sparse(thruster_matrix(self.robot))


def observe_function(laws: TickLaws) -> ca.Function:
    """Function ``given, effect, known -> now``: what it knows once it has looked, but for what it asks in this tick."""
    x, (given, effect, known) = _symbols(laws, given=Given, effect=Effect, known=Known)
    gain = min(1.0, laws.velocity.dt / _EASE)
    share = known.share + gain * (_by_part(laws, given.feedback, given.joint_feedback) - known.share)
    integral = _by_part(laws, ca.if_else(given.stop, 0.0, known.integral), known.integral)
    now = replace(known, share=share, integral=integral)
    now = now if laws.observer is None else _observed(laws, laws.observer, given, effect, now)
    now = now if laws.intake is None else _taken_in(laws, laws.intake, given, now)
    return ca.Function("observe", list(x.values()), [ca.cse(column_of(now))], list(x), ["now"])


def want_function(laws: TickLaws) -> ca.Function:
    """Function ``given, now -> wanted``."""
    x, (given, now) = _symbols(laws, given=Given, now=Known)
    trusted = _by_part(laws, 1.0 - given.hold, given.joints)
    error = ca.if_else(trusted, given.reference - given.v, 0.0)
    tau = laws.velocity.force(given.q, given.reference, now.before, error, now.integral, now.share) - now.estimate
    force = _by_part(laws, ca.if_else(given.stop, 0.0, tau), tau)
    n = laws.robot.n_vehicle
    wanted = Wanted(
        error=error,
        force=force,
        wrench=ca.vertcat(force[:n], ca.SX.zeros(6 - n)),
        torque=limited(force[n:], laws.robot.limits.effort),
    )
    return ca.Function("want", list(x.values()), [ca.cse(column_of(wanted))], list(x), ["wanted"])


def follow_function(laws: TickLaws) -> ca.Function:
    """Function ``given, effect, now, wanted, allocated -> known, told``, known for the next tick."""
    kinds: dict[str, type[Any]] = {"given": Given, "effect": Effect, "now": Known, "wanted": Wanted}
    x, (given, effect, now, wanted, allocated) = _symbols(laws, **kinds, allocated=Allocated)
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
    told = Told(
        command=command,
        torque=wanted.torque,
        disturbance=now.estimate,
        vehicle_force=wanted.force[:n],
        unreachable=allocated.unreachable,
        push=ca.dot(_up(given.q), now.estimate[:3]) / laws.lift if n else ca.SX(1, 1),
    )
    return ca.Function("follow", list(x.values()), [column_of(known), column_of(told)], list(x), ["known", "told"])


def _observed(laws: TickLaws, law: ObserverLaw, given: Given, effect: Effect, now: Known) -> Known:
    """Where the velocity is not to be trusted the estimate is kept, or set to zero where the robot is stopped."""
    wrench = ca.mtimes(laws.matrix, effect.given(now.thrust))
    force = ca.vertcat(wrench[: laws.robot.n_vehicle], now.torque)
    before = Observed(estimate=now.estimate, lead=now.lead, v_hat=now.v_hat, follows=now.follows)
    found = law.after(before, laws.velocity.dynamics, given.q, given.v, force, now.share)
    held = partial(ca.if_else, given.hold)
    return replace(
        now,
        estimate=held(ca.if_else(given.stop, 0.0, now.estimate), found.estimate),
        lead=held(now.lead, found.lead),
        v_hat=held(now.v_hat, found.v_hat),
        follows=held(0.0, found.follows),
    )


def _taken_in(laws: TickLaws, intake: Intake, given: Given, now: Known) -> Known:
    """While everything is fed back with nearly the full bandwidth."""
    joints = given.joints if laws.robot.n_joints else 1.0
    watches = ca.logic_and(ca.logic_and(1.0 - given.hold, joints), now.share[0] >= _FULL)
    after = intake.after(Asked(thrust=now.asked, way=now.way, ticks=now.ticks), now.thrust, now.before)
    when = partial(ca.if_else, watches)
    status = ca.if_else(after.ticks == 0.0, float(Watch.DUE), float(Watch.TAKES_IN))
    return replace(
        now,
        asked=when(after.thrust, now.asked),
        way=when(after.way, now.way),
        ticks=when(after.ticks, now.ticks),
        watch=when(status, float(Watch.PAUSED)),
    )


def _symbols(laws: TickLaws, **kinds: type[Any]) -> tuple[dict[str, ca.SX], tuple[Any, ...]]:
    """Columns by name, and the parts of each."""
    columns, parts = {}, []
    for name, kind in kinds.items():
        columns[name] = ca.SX.sym(name, size_of(kind, laws.sizes))
        parts.append(parts_of(kind, laws.sizes, columns[name]))
    return columns, tuple(parts)


def _by_part(laws: TickLaws, vehicle: ca.SX, joints: ca.SX) -> ca.SX:
    """(n_v,) of the axes of the vehicle the one, of the joints the other; either may be one number for all."""
    n_v, n = laws.robot.n_v, laws.robot.n_vehicle
    vehicle, joints = (ca.repmat(part, n_v) if part.is_scalar() else part for part in (vehicle, joints))
    return ca.vertcat(vehicle[:n], joints[n:])


def _up(q: ca.SX) -> ca.SX:
    """z of W in B (3,) [-], of the quaternion xyzw in q."""
    x, y, z, w = ca.vertsplit(q[3:7])
    return ca.vertcat(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
