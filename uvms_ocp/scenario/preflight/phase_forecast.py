"""Foretell the phases of a mission without trouble, and where the vehicle may stand in each."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked
from uvms_ocp.mission import Phase
from uvms_ocp.record.meta_values import DONE
from uvms_ocp.robot import thrusters
from uvms_ocp.scenario.preflight.setup import Setup
from uvms_ocp.tasks import Alignment, LandingAltitude, NullVelocity, Task, VehiclePose, goals

_N_RIM = 8  # positions on the rim of the ball in which a phase may end
_BEND = 0.3  # [rad] angle from the straight way at which a way point may be approached
_OVERHEAD = 1e-3  # [m] horizontal distance below which a target has no direction, as for tasks
AnyTask = TypeVar("AnyTask", bound=Task)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Stance:
    """A pose of the vehicle, level, at which a phase may begin or end."""

    position: np.ndarray
    """(3,) [m] p_WB of the vehicle in W."""
    yaw: float
    """[rad] Heading of the vehicle in W."""
    likely: bool = True
    """True for a stance that is likely, and not merely possible."""

    @property
    def X_WB(self) -> pin.SE3:
        return pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, self.yaw), self.position)

    def configuration(self, setup: Setup) -> np.ndarray:
        """Return q (n_q,) [m, rad] with the joints as at the start."""
        q = setup.start.copy()
        q[:7] = pin.SE3ToXYZQUAT(self.X_WB)
        return q


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Visit:
    """One phase of the mission, with the stances that the vehicle may have at its end."""

    index: int
    """Number of the phase in the mission."""
    phase: Phase
    """The phase itself."""
    tasks: tuple[Task, ...]
    """Tasks that are on, with the goals of this phase."""
    stances: tuple[Stance, ...]
    """Stances at its end, the likeliest first."""

    def active(self, kind: type[AnyTask]) -> AnyTask | None:
        """Return the first task of a kind that is on."""
        return next((task for task in self.tasks if isinstance(task, kind)), None)


@checked
def forecast(setup: Setup) -> list[Visit]:
    """Foretell the phases in the order in which a mission without trouble goes through them, and
    where the vehicle is at the end of each.
    """
    start = setup.start
    yaw = float(pin.rpy.matrixToRpy(pin.Quaternion(start[3:7]).matrix())[2])
    stances: tuple[Stance, ...] = (Stance(position=start[:3].copy(), yaw=yaw),)
    visits = []
    for index in main_path(setup.mission.phases):
        phase = setup.mission.phases[index]
        tasks = tuple(task for task in setup.mission.tasks_of(index) if task.name in phase.on)
        visit = Visit(index=index, phase=phase, tasks=tasks, stances=stances)
        stances = _stances_after(setup, visit)
        visits.append(replace(visit, stances=stances))
    return visits


def main_path(phases: Sequence[Phase]) -> list[int]:
    """Return the indices of the phases from the first on, by the first transition of each that leads to a new
    one.
    """
    names = [phase.name for phase in phases]
    path = [0]
    index = 0
    while True:
        targets = [transition.to for transition in phases[index].transitions]
        successors = [names.index(name) for name in targets if name in names]
        new_successors = [successor for successor in successors if successor not in path]
        if DONE in targets or not new_successors:
            return path
        index = new_successors[0]
        path.append(index)


def threshold_of(phase: Phase, quantity: str) -> float | None:
    """Return the threshold [m] or [rad] below which `quantity` must fall to leave the phase; `None` where
    it does not matter.
    """
    limits = []
    for condition in phase.conditions:
        if condition.is_below and condition.quantity == quantity:
            limits.append(condition.limit)
    return min(limits, default=None)


def points_on_ball(centre: np.ndarray, radius: float) -> Iterator[np.ndarray]:
    """Yield the centre (3,) [m] of a ball of `radius` [m], and points on its horizontal rim.

    There the distances to anything outside are extreme.
    """
    yield centre
    if radius <= 0:
        return
    for k in range(_N_RIM):
        angle = 2 * math.pi * k / _N_RIM
        yield centre + radius * np.array([math.cos(angle), math.sin(angle), 0.0])


def _stances_after(setup: Setup, visit: Visit) -> tuple[Stance, ...]:
    """Return the stances at the end of a phase whose `stances` are those at its beginning."""
    stances = visit.stances
    if visit.active(NullVelocity) is not None:
        return stances
    pose = visit.active(VehiclePose)
    if pose is not None:
        goal, _ = goals.evaluate_pose(pose.name, pose.goal, 0.0)
        radius = threshold_of(visit.phase, f"{pose.name}.position_error") or 0.0
        stances = stances_at_way_point(
            goal, radius, origin=stances[0].position, towards=_next_target(setup, visit)
        )
    alignment = visit.active(Alignment)
    if alignment is not None:
        target, _ = goals.evaluate_vector(alignment.name, alignment.goal, 0.0)
        drives_all_axes = not thrusters.undriven_axes(setup.robot)
        stances = tuple(_aligned(stance, target, walks=drives_all_axes) for stance in stances)
    landing = visit.active(LandingAltitude)
    if landing is not None:
        altitude = threshold_of(visit.phase, f"{landing.name}.altitude") or landing.rest_altitude
        height = setup.altimeter_height()
        stances = tuple(_landed(setup, stance, altitude, height) for stance in stances)
    return stances


def _landed(setup: Setup, stance: Stance, altitude: float, height: float) -> Stance:
    """Return the stance with the altimeter at an altitude [m] over the floor.

    height: [m] of the altimeter above the vehicle's origin.
    """
    x, y, _ = stance.position
    z = setup.floor_at(x, y) + altitude - height
    return replace(stance, position=np.array((x, y, z)))


def stances_at_way_point(
    goal: pin.SE3, radius: float, *, origin: np.ndarray, towards: np.ndarray | None = None
) -> tuple[Stance, ...]:
    """Return stances in a ball of `radius` [m] around a way point.

    The first is where the straight way from `origin` (3,) [m] in W enters the ball. Those to either
    side of it are as likely, as currents and obstacles bend the way. Then come, merely possible, the
    centre and points of the rim, the first of them towards a point `towards` (3,) [m] in W.
    """
    yaw = float(pin.rpy.matrixToRpy(goal.rotation)[2])
    centre = goal.translation
    if towards is None:
        rim_direction = 0.0
    else:
        x, y, _ = towards - centre
        rim_direction = math.atan2(y, x)
    R = pin.rpy.rpyToMatrix(0.0, 0.0, rim_direction)
    possible = []
    for point in points_on_ball(np.zeros(3), radius):
        possible.append(Stance(position=centre + R @ point, yaw=yaw, likely=radius == 0))
    if radius <= 0:
        return tuple(possible)
    offset = origin - centre
    arrival = offset * min(1.0, radius / max(float(np.linalg.norm(offset)), 1e-9))
    likely = []
    for bend in (0.0, _BEND, -_BEND):
        point = pin.rpy.rpyToMatrix(0.0, 0.0, bend) @ arrival
        likely.append(Stance(position=centre + point, yaw=yaw))
    return (*likely, *possible)


def _next_target(setup: Setup, visit: Visit) -> np.ndarray | None:
    """Return the target (3,) [m] in W of the alignment of this mission, towards and away from which
    reach is best and worst.
    """
    for task in setup.mission.tasks_of(visit.index):
        if isinstance(task, Alignment):
            return goals.evaluate_vector(task.name, task.goal, 0.0)[0]
    return None


def _aligned(stance: Stance, target: np.ndarray, *, walks: bool) -> Stance:
    """Return the stance after turning to a target by the least motion: part of the turn is a walk
    around the target.

    With d the distance, ``d theta = -(d psi + ds / d)`` and the least ``d psi^2 + ds^2`` share the
    angle as d^2 : 1 between turning and walking, with 1 m as much as 1 rad, as in the hierarchy. A
    vehicle that does not drive every axis turns on the spot.
    """
    offset = stance.position[:2] - target[:2]
    d = float(np.linalg.norm(offset))
    if d < _OVERHEAD:
        return stance
    bearing = math.atan2(-offset[1], -offset[0])
    theta = math.remainder(bearing - stance.yaw, 2 * math.pi)
    walk = 0.0
    if walks:
        walk = -theta / (d**2 + 1.0)
    R = pin.rpy.rpyToMatrix(0.0, 0.0, walk)[:2, :2]
    x, y = target[:2] + R @ offset
    return replace(stance, position=np.array([x, y, stance.position[2]]), yaw=bearing + walk)
