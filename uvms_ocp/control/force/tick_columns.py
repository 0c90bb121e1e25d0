"""What a tick of the force layer is given, knows, wants and tells: named parts of columns of numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Annotated, Any, TypeVar

import casadi as ca

from uvms_ocp.functions.elementwise import Array
from uvms_ocp.functions.kernels.layout import Layout, Sized, declared_sizes, view
from uvms_ocp.model.robot import Robot

Parts = TypeVar("Parts", bound=Layout)


class Watch(IntEnum):
    """Of the monitor of actuators."""

    PAUSED = 0
    """What is measured is not to be trusted."""
    TAKES_IN = 1
    """What was asked."""
    DUE = 2
    """For a look, besides."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Given(Layout):
    """What a tick is given."""

    q: Annotated[Array, Sized("n_q")]
    """(n_q,) [m, rad] measured."""
    v: Annotated[Array, Sized("n_v")]
    """(n_v,) [m/s, rad/s] measured."""
    reference: Annotated[Array, Sized("n_v")]
    """(n_v,) [m/s, rad/s] velocity that is asked for."""
    feedback: Annotated[Array, Sized(1)]
    """(1,) [-] share of their bandwidth that the loops of the vehicle come to."""
    joint_feedback: Annotated[Array, Sized(1)]
    """(1,) [-] the same of the joints."""
    hold: Annotated[Array, Sized(1)]
    """(1,) [-] 1: the vehicle's velocity is not to be trusted."""
    stop: Annotated[Array, Sized(1)]
    """(1,) [-] 1: no thrust."""
    joints: Annotated[Array, Sized(1)]
    """(1,) [-] 1: the joints' velocities are to be trusted."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Known(Layout):
    """What it remembers: all of it 0 before the first tick, but the share, which is 1."""

    thrust: Annotated[Array, Sized("n_thrusters")]
    """(n_thrusters,) [N] modelled, of thrusters that all follow their commands."""
    torque: Annotated[Array, Sized("n_joints")]
    """(n_joints,) [N m or N] last asked."""
    estimate: Annotated[Array, Sized("n_v")]
    """(n_v,) [N, N m] disturbance."""
    lead: Annotated[Array, Sized("n_v")]
    """(n_v,) [N, N m] as `Observed.lead`."""
    v_hat: Annotated[Array, Sized("n_v")]
    """(n_v,) [m/s, rad/s] that the observer expects."""
    follows: Annotated[Array, Sized(1)]
    """(1,) [-] 1 where v_hat is known."""
    share: Annotated[Array, Sized("n_v")]
    """(n_v,) [-] of the bandwidth."""
    integral: Annotated[Array, Sized("n_v")]
    """(n_v,) [m, rad] of the error."""
    before: Annotated[Array, Sized("n_v")]
    """(n_v,) [m/s, rad/s] the last reference."""
    asked: Annotated[Array, Sized("n_thrusters")]
    """(n_thrusters,) [N] as `Asked.thrust`."""
    way: Annotated[Array, Sized("n_v")]
    """(n_v,) [m/s, rad/s] as `Asked.way`."""
    ticks: Annotated[Array, Sized(1)]
    """(1,) [-] as `Asked.ticks`."""
    watch: Annotated[Array, Sized(1)]
    """(1,) [-] a `Watch`."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Wanted(Layout):
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
class Allocated(Layout):
    """What thrusters make of it, as `AllocationResult`."""

    thrust: Annotated[Array, Sized("n_thrusters")]
    """(n_thrusters,) [N]"""
    reached: Annotated[Array, Sized(6)]
    """(6,) [N, N m]"""
    unreachable: Annotated[Array, Sized(6)]
    """(6,) [N, N m]"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Told(Layout):
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
    """(1,) [-] upward part of the disturbance, as a share of the largest lift of the thrusters."""


def sizes_of(robot: Robot) -> dict[str, int]:
    """Sizes [-] that parts are declared with, by name."""
    return {
        "n_q": robot.n_q,
        "n_v": robot.n_v,
        "n_vehicle": robot.n_vehicle,
        "n_joints": robot.n_joints,
        "n_thrusters": len(robot.description.thrusters),
    }


def places_of(parts: type[Layout], sizes: Mapping[str, int]) -> dict[str, slice]:
    """Where each part of a column is, by its name. As in memory, there is room for one number where there is none."""
    places, at = {}, 0
    for name, size in declared_sizes(parts, sizes).items():
        places[name] = slice(at, at + size)
        at += max(1, size)
    return places


def size_of(parts: type[Layout], sizes: Mapping[str, int]) -> int:
    """Of the whole column [-]."""
    return sum(max(1, size) for size in declared_sizes(parts, sizes).values())


def parts_of(parts: type[Parts], sizes: Mapping[str, int], column: Array) -> Parts:
    """Slices of a column (n,) [any] of expressions."""
    return parts(**{name: column[place] for name, place in places_of(parts, sizes).items()})


def views_of(parts: type[Parts], sizes: Mapping[str, int], memory: Any) -> Parts:
    """Arrays of numbers on the memory of a column."""
    declared = declared_sizes(parts, sizes).items()
    return parts(**{name: view(getattr(memory, name))[:size] for name, size in declared})


def column_of(parts: Any) -> ca.SX:
    """All parts, which are expressions, one below the other."""
    columns = [getattr(parts, field.name) for field in fields(parts)]
    return ca.densify(ca.vertcat(*(column if column.numel() else ca.SX(1, 1) for column in columns)))
