"""Where the vehicle will be in each phase, foretold from the goals and thresholds of the mission."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import checked
from uvms_ocp.mission.conditions import DONE, Below
from uvms_ocp.mission.phase import Phase
from uvms_ocp.preflight.setup import Setup
from uvms_ocp.tasks.altitude import LandingAltitude
from uvms_ocp.tasks.attitude import Alignment
from uvms_ocp.tasks.pose import VehiclePose
from uvms_ocp.tasks.reference import evaluate_pose, evaluate_vector
from uvms_ocp.tasks.task import Task
from uvms_ocp.tasks.velocity import NullVelocity

_N_RIM = 8  # positions on the rim of the ball in which a phase may end
_BEND = 0.3  # [rad] by which a way point may be entered beside the straight way
_OVERHEAD = 1e-3  # [m] nearer to the target its direction is not defined

AnyTask = TypeVar("AnyTask", bound=Task)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Stance:
    """A pose of the vehicle, level, at which a phase may begin or end."""

    position: np.ndarray
    """(3,) [m] p_WB"""
    yaw: float
    """[rad]"""
    likely: bool = True
    """Not merely possible."""

    @property
    def X_WB(self) -> pin.SE3:
        return pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, self.yaw), self.position)

    def configuration(self, setup: Setup) -> np.ndarray:
        """q (n_q,) [m, rad] with the joints as at the start."""
        q = setup.start.copy()
        q[:7] = pin.SE3ToXYZQUAT(self.X_WB)
        return q


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Visit:
    """One phase on the way, with the stances that the vehicle may have at its end; the first is the likeliest."""

    index: int
    phase: Phase
    tasks: tuple[Task, ...]
    """Switched on, with the goals of this phase."""
    stances: tuple[Stance, ...]

    def active(self, kind: type[AnyTask]) -> AnyTask | None:
        """The first task of a kind that is on."""
        return next((task for task in self.tasks if isinstance(task, kind)), None)


@checked
def forecast(setup: Setup) -> list[Visit]:
    """The phases in the order in which a mission without trouble goes through them."""
    start = setup.start
    yaw = float(pin.rpy.matrixToRpy(pin.Quaternion(start[3:7]).matrix())[2])
    stances: tuple[Stance, ...] = (Stance(position=start[:3].copy(), yaw=yaw),)
    visits = []
    for index in main_path(setup.mission.phases):
        phase = setup.mission.phases[index]
        on = {name for name, gate in phase.gates.items() if gate > 0}
        tasks = tuple(task for task in setup.mission.tasks_of(index) if task.name in on)
        visit = Visit(index=index, phase=phase, tasks=tasks, stances=stances)
        stances = _stances_after(setup, visit)
        visits.append(replace(visit, stances=stances))
    return visits


def main_path(phases: Sequence[Phase]) -> list[int]:
    """Indices of the phases from the first on, by the first transition of each that leads to a new one."""
    names = [phase.name for phase in phases]
    path, index = [0], 0
    while True:
        targets = [transition.to for transition in phases[index].transitions]
        fresh = [names.index(name) for name in targets if name in names and names.index(name) not in path]
        if DONE in targets or not fresh:
            return path
        index = fresh[0]
        path.append(index)


def limit_of(phase: Phase, quantity: str) -> float | None:
    """The threshold [m] or [rad] below which `quantity` must fall to leave the phase; `None` where it does not matter."""
    limits = [
        condition.limit
        for transition in phase.transitions
        for condition in transition.when
        if isinstance(condition, Below) and condition.quantity == quantity
    ]
    return min(limits, default=None)


def ball(centre: np.ndarray, radius: float) -> Iterator[np.ndarray]:
    """The centre (3,) [m] of a ball of `radius` [m] and points on its horizontal rim.

    There the distances to anything outside are extreme.
    """
    yield centre
    for k in range(_N_RIM if radius > 0 else 0):
        angle = 2 * math.pi * k / _N_RIM
        yield centre + radius * np.array([math.cos(angle), math.sin(angle), 0.0])


def _stances_after(setup: Setup, visit: Visit) -> tuple[Stance, ...]:
    if visit.active(NullVelocity) is not None:
        return visit.stances
    stances = visit.stances
    pose = visit.active(VehiclePose)
    if pose is not None:
        goal, _ = evaluate_pose(pose.name, pose.goal, 0.0)
        radius = limit_of(visit.phase, f"{pose.name}.position_error") or 0.0
        origin = visit.stances[0].position
        stances = way_point_stances(goal, radius, origin=origin, towards=_next_target(setup, visit))
    alignment = visit.active(Alignment)
    if alignment is not None:
        target, _ = evaluate_vector(alignment.name, alignment.goal, 0.0)
        stances = tuple(_aligned(stance, target) for stance in stances)
    landing = visit.active(LandingAltitude)
    if landing is not None:
        aim = landing.landing_distance + landing.safeguard
        altitude = limit_of(visit.phase, f"{landing.name}.altitude") or aim
        stances = tuple(_landed(setup, stance, altitude) for stance in stances)
    return stances


def way_point_stances(
    goal: pin.SE3, radius: float, *, origin: np.ndarray, towards: np.ndarray | None = None
) -> tuple[Stance, ...]:
    """Stances in a ball of `radius` [m] around a way point.

    The first is where the straight way from `origin` (3,) [m] in W enters it.

    Likely are those too to either side of it, as currents and obstacles bend the way. Then come, merely possible, the
    centre and the rim, which begins in the direction of `towards` (3,) [m] in W.
    """
    yaw = float(pin.rpy.matrixToRpy(goal.rotation)[2])
    offset = origin - goal.translation
    arrival = offset * min(1.0, radius / max(float(np.linalg.norm(offset)), 1e-9))
    turned = (pin.rpy.rpyToMatrix(0.0, 0.0, angle) @ arrival for angle in (0.0, _BEND, -_BEND))
    likely = [Stance(position=goal.translation + point, yaw=yaw) for point in turned]
    around = _ball_towards(goal.translation, radius, towards)
    possible = [Stance(position=point, yaw=yaw, likely=radius == 0) for point in around]
    return (*likely, *possible) if radius > 0 else tuple(possible)


def _ball_towards(centre: np.ndarray, radius: float, towards: np.ndarray | None) -> Iterator[np.ndarray]:
    offset = np.zeros(2) if towards is None else towards[:2] - centre[:2]
    R = pin.rpy.rpyToMatrix(0.0, 0.0, math.atan2(offset[1], offset[0]))
    for point in ball(np.zeros(3), radius):
        yield centre + R @ point


def _next_target(setup: Setup, visit: Visit) -> np.ndarray | None:
    """Target of the alignment of this mission, towards and away from which reach is best and worst."""
    alignment = next((task for task in setup.mission.tasks_of(visit.index) if isinstance(task, Alignment)), None)
    return None if alignment is None else evaluate_vector(alignment.name, alignment.goal, 0.0)[0]


def _aligned(stance: Stance, target: np.ndarray) -> Stance:
    """After turning to a target by the least motion: part of the turn is a walk around the target.

    With d the distance, ``d theta = -(d psi + ds / d)`` and the least ``d psi^2 + ds^2`` share the angle as
    d^2 : 1 between turning and walking.
    """
    offset = stance.position[:2] - target[:2]
    d = float(np.linalg.norm(offset))
    if d < _OVERHEAD:
        return stance
    bearing = math.atan2(-offset[1], -offset[0])
    theta = math.remainder(bearing - stance.yaw, 2 * math.pi)
    walk = -theta / (d**2 + 1.0)
    R = pin.rpy.rpyToMatrix(0.0, 0.0, walk)[:2, :2]
    return replace(stance, position=np.array([*(target[:2] + R @ offset), stance.position[2]]), yaw=bearing + walk)


def _landed(setup: Setup, stance: Stance, altitude: float) -> Stance:
    x, y, _ = stance.position
    return replace(stance, position=np.array([x, y, setup.floor_at(x, y) + altitude - setup.altimeter_height()]))
