"""What a tick of the force layer is given, knows, wants and tells: named parts of columns of numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any, TypeVar

import casadi as ca

from uvms_ocp.functions.elementwise import Array
from uvms_ocp.model.robot import Robot

Parts = TypeVar("Parts")


class Watch(IntEnum):
    """Of the monitor of actuators."""

    PAUSED = 0
    """What is measured is not to be trusted."""
    TAKES_IN = 1
    """What was asked."""
    DUE = 2
    """For a look, besides."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Given:
    """What a tick is given."""

    q: Array
    """(n_q,) [m, rad] measured."""
    v: Array
    """(n_v,) [m/s, rad/s] measured."""
    reference: Array
    """(n_v,) [m/s, rad/s] velocity that is asked for."""
    feedback: Array
    """(1,) [-] share of their bandwidth that the loops of the vehicle come to."""
    joint_feedback: Array
    """(1,) [-] the same of the joints."""
    hold: Array
    """(1,) [-] 1: the vehicle's velocity is not to be trusted."""
    stop: Array
    """(1,) [-] 1: no thrust."""
    joints: Array
    """(1,) [-] 1: the joints' velocities are to be trusted."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Known:
    """What it remembers: all of it 0 before the first tick, but the share, which is 1."""

    thrust: Array
    """(n_thrusters,) [N] modelled, of thrusters that all follow their commands."""
    torque: Array
    """(n_joints,) [N m or N] last asked."""
    estimate: Array
    """(n_v,) [N, N m] disturbance."""
    lead: Array
    """(n_v,) [N, N m] as `Observed.lead`."""
    v_hat: Array
    """(n_v,) [m/s, rad/s] that the observer expects."""
    follows: Array
    """(1,) [-] 1 where v_hat is known."""
    share: Array
    """(n_v,) [-] of the bandwidth."""
    integral: Array
    """(n_v,) [m, rad] of the error."""
    before: Array
    """(n_v,) [m/s, rad/s] the last reference."""
    asked: Array
    """(n_thrusters,) [N] as `Asked.thrust`."""
    way: Array
    """(n_v,) [m/s, rad/s] as `Asked.way`."""
    ticks: Array
    """(1,) [-] as `Asked.ticks`."""
    watch: Array
    """(1,) [-] a `Watch`."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Wanted:
    """What it wants, before thrusters are looked at."""

    error: Array
    """(n_v,) [m/s, rad/s] of the velocity, 0 where that is not to be trusted."""
    force: Array
    """(n_v,) [N, N m]"""
    wrench: Array
    """(6,) [N, N m] of it, of thrusters."""
    torque: Array
    """(n_joints,) [N m or N] of it, inside the limits."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Allocated:
    """What thrusters make of it, as `AllocationResult`."""

    thrust: Array
    """(n_thrusters,) [N]"""
    reached: Array
    """(6,) [N, N m]"""
    unreachable: Array
    """(6,) [N, N m]"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Told:
    """What it tells."""

    command: Array
    """(n_thrusters,) [N] asked of the thrusters."""
    torque: Array
    """(n_joints,) [N m or N] asked of the joint motors."""
    disturbance: Array
    """(n_v,) [N, N m]"""
    vehicle_force: Array
    """(n_vehicle,) [N, N m] wanted of the thrusters."""
    unreachable: Array
    """(6,) [N, N m] of that."""
    push: Array
    """(1,) [-] upward part of the disturbance, as a share of the largest lift of the thrusters."""


def sizes_of(robot: Robot) -> dict[str, int]:
    """Size [-] of each part, by its name."""
    n_v, n_thrusters = robot.n_v, len(robot.description.thrusters)
    axes = ("v", "reference", "estimate", "lead", "v_hat", "share", "integral", "before", "way")
    return {
        "q": robot.n_q,
        **dict.fromkeys((*axes, "error", "force", "disturbance"), n_v),
        **dict.fromkeys(("thrust", "asked", "command", "constant"), n_thrusters),
        "torque": robot.n_joints,
        "vehicle_force": robot.n_vehicle,
        **dict.fromkeys(("wrench", "reached", "unreachable"), 6),
        **dict.fromkeys(
            ("feedback", "joint_feedback", "hold", "stop", "joints", "follows", "ticks", "watch", "push"), 1
        ),
    }


def places_of(parts: type[Any], sizes: Mapping[str, int]) -> dict[str, slice]:
    """Where each part of a column is, by its name."""
    places, at = {}, 0
    for field in fields(parts):
        places[field.name] = slice(at, at + sizes[field.name])
        at += sizes[field.name]
    return places


def size_of(parts: type[Any], sizes: Mapping[str, int]) -> int:
    """Of the whole column [-]."""
    return sum(sizes[field.name] for field in fields(parts))


def parts_of(parts: type[Parts], sizes: Mapping[str, int], column: Array) -> Parts:
    """Views of a column (n,) [any] of numbers, or slices of one of expressions."""
    return parts(**{name: column[place] for name, place in places_of(parts, sizes).items()})


def column_of(parts: Any) -> ca.SX:
    """All parts, which are expressions, one below the other."""
    return ca.densify(ca.vertcat(*(getattr(parts, field.name) for field in fields(parts))))
