"""Inputs and results of pre-flight checks: the mission before it begins, forecast of its phases,
findings, report.
"""

from __future__ import annotations

import enum
import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, TypeVar

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.control.force.dynamic import VelocityGains
from uvms_ocp.mission import Below, Mission, Phase
from uvms_ocp.record.display import WIDTH, SmallTable, TableDisplay
from uvms_ocp.record.meta_values import DONE
from uvms_ocp.robot import IDEAL_SENSORS, Robot, SensorSpecs, static_balance, thrusters
from uvms_ocp.robot.robot import require_normalized
from uvms_ocp.sim.environment import Environment
from uvms_ocp.tasks import Alignment, LandingAltitude, NullVelocity, Task, VehiclePose, goals
from uvms_ocp.types import Finite, Period, Shape

_N_RIM = 8  # positions on the rim of the ball in which a phase may end
_BEND = 0.3  # [rad] by which a way point may be entered beside the straight way
_OVERHEAD = 1e-3  # [m] nearer to the target its direction is not defined

AnyTask = TypeVar("AnyTask", bound=Task)


# What the checks found.


class Severity(enum.Enum):
    """How bad a finding is."""

    ERROR = "error"
    """The mission cannot be completed as it is."""
    WARNING = "warning"
    """It may fail, or do what was not meant."""
    NOTE = "note"
    """A figure worth knowing."""

    def finding(self, check: str, text: str, phase: str = "", **figures: Any) -> Finding:
        """Make a finding of this severity; figures [m, rad, N] by name."""
        return Finding(severity=self, check=check, phase=phase, text=text, figures=figures)


@checked_dataclass()
class Finding:
    """One result of one check, in one sentence, with its figures (lengths in m, angles in rad,
    forces in N).
    """

    severity: Severity
    check: str
    text: str
    phase: str = ""
    """Name of the phase concerned."""
    figures: Mapping[str, Any] = field(default_factory=dict)


@checked_dataclass(repr=False)
class PreflightReport(TableDisplay):
    """All findings of one mission, errors first."""

    findings: tuple[Finding, ...]

    def __post_init__(self) -> None:
        order = list(Severity)
        object.__setattr__(
            self,
            "findings",
            tuple(sorted(self.findings, key=lambda finding: order.index(finding.severity))),
        )

    def _table(self) -> SmallTable:
        verdict = "accepted" if self.accepted else "refused"
        labels = [(item.severity.value, item.phase, item.check) for item in self.findings]
        head = ("severity", "phase", "check")
        width = max(
            WIDTH
            - sum(2 + max(map(len, column)) for column in zip(head, *labels, strict=True))
            - 2,
            30,
        )
        texts = [textwrap.wrap(item.text, width) or [""] for item in self.findings]
        pairs = zip(labels, texts, strict=True)
        rows = []
        for cells, lines in pairs:
            rows.append((*cells, lines[0]))
            rows += [("", "", "", line) for line in lines[1:]]
        return SmallTable(title=f"Pre-flight: {verdict}", head=(*head, "finding"), rows=tuple(rows))

    @property
    def errors(self) -> tuple[Finding, ...]:
        return self._of(Severity.ERROR)

    @property
    def warnings(self) -> tuple[Finding, ...]:
        return self._of(Severity.WARNING)

    @property
    def accepted(self) -> bool:
        """No error was found."""
        return not self.errors

    def of_check(self, check: str) -> tuple[Finding, ...]:
        """The findings of one check, such as ``reachability``."""
        return tuple(finding for finding in self.findings if finding.check == check)

    def to_dict(self) -> dict[str, Any]:
        """JSON values only."""
        rows = [
            {
                "severity": finding.severity.value,
                "check": finding.check,
                "phase": finding.phase,
                "text": finding.text,
            }
            | {"figures": dict(finding.figures)}
            for finding in self.findings
        ]
        return {"accepted": self.accepted, "findings": rows}

    def _of(self, severity: Severity) -> tuple[Finding, ...]:
        return tuple(finding for finding in self.findings if finding.severity is severity)


# What the checks look at.


@checked_dataclass(eq=False)
class Setup:
    """A mission before it begins."""

    robot: Robot
    mission: Mission
    environment: Environment
    start: Annotated[np.ndarray, Shape("robot.n_q")]
    """(n_q,) [m, rad]"""
    altimeter_frame: str | None
    """`None` for a robot without an altimeter."""
    with_forces: bool
    """The plant has thrusters and water, so that forces matter."""
    dt: Period
    """[s] control period."""
    duration: Finite
    """[s] time limit."""
    sensors: SensorSpecs = IDEAL_SENSORS
    """Specifications of the sensors that it is monitored by while it runs."""
    own_parts: Mapping[str, str] = field(default_factory=dict)
    """Names of the parts that are not the toolkit's, by what they are, such as ``plant``."""
    gains: VelocityGains = field(default_factory=VelocityGains)
    """Gains of the loops, before they are lowered for sensors that are late."""
    load_bandwidth: Finite | None = None
    """[rad/s] of the observer from which the controller is to learn what the tool carries; `None`
    where it is not to.
    """

    def floor_at(self, x: float, y: float) -> float:
        """Height [m] of the floor in W at x [m], y [m]."""
        return self.environment.seafloor.height(float(x), float(y))

    def altimeter_pose(self, q: Annotated[np.ndarray, Shape("self.robot.n_q")]) -> pin.SE3:
        """X_WS at q (n_q,) [m, rad]; the vehicle's own pose without an altimeter."""
        require_normalized(self.robot.model, q)
        if self.altimeter_frame is None:
            return pin.XYZQUATToSE3(np.asarray(q[:7]))
        return frame_pose(self.robot, q, self.altimeter_frame)

    def altimeter_height(self) -> float:
        """Height [m] of the altimeter above the vehicle's origin while the vehicle rests as
        thrusters and water leave it.
        """
        place: np.ndarray = self.altimeter_pose(self.robot.configuration()).translation
        return float(
            static_balance.rotation_at_rest(self.robot, self.start)[2] @ place
            if self.with_forces
            else place[2]
        )


def frame_pose(robot: Robot, q: np.ndarray, frame: str) -> pin.SE3:
    """X_WF of a frame at q (n_q,) [m, rad], which may be outside the limits. Raises
    `FrameNotFound`.
    """
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    return pin.updateFramePlacement(robot.model, data, robot.frame_id(frame)).copy()


# Where the vehicle will be in each phase, foretold from the goals and thresholds of the mission.


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
        """Q (n_q,) [m, rad] with the joints as at the start."""
        q = setup.start.copy()
        q[:7] = pin.SE3ToXYZQUAT(self.X_WB)
        return q


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Visit:
    """One phase on the way, with the stances that the vehicle may have at its end; the first is the
    likeliest.
    """

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
        tasks = tuple(task for task in setup.mission.tasks_of(index) if task.name in phase.on)
        visit = Visit(index=index, phase=phase, tasks=tasks, stances=stances)
        stances = _stances_after(setup, visit)
        visits.append(replace(visit, stances=stances))
    return visits


def main_path(phases: Sequence[Phase]) -> list[int]:
    """Indices of the phases from the first on, by the first transition of each that leads to a new
    one.
    """
    names = [phase.name for phase in phases]
    path = [0]
    index = 0
    while True:
        targets = [transition.to for transition in phases[index].transitions]
        fresh = [
            names.index(name) for name in targets if name in names and names.index(name) not in path
        ]
        if DONE in targets or not fresh:
            return path
        index = fresh[0]
        path.append(index)


def threshold_of(phase: Phase, quantity: str) -> float | None:
    """The threshold [m] or [rad] below which `quantity` must fall to leave the phase; `None` where
    it does not matter.
    """
    awaited = (
        condition
        for condition in phase.conditions
        if isinstance(condition, Below) and condition.quantity == quantity
    )
    return min((condition.limit for condition in awaited), default=None)


def points_on_ball(centre: np.ndarray, radius: float) -> Iterator[np.ndarray]:
    """The centre (3,) [m] of a ball of `radius` [m] and points on its horizontal rim.

    There the distances to anything outside are extreme.
    """
    yield centre
    for k in range(_N_RIM if radius > 0 else 0):
        angle = 2 * math.pi * k / _N_RIM
        yield centre + radius * np.array([math.cos(angle), math.sin(angle), 0.0])


def _stances_after(setup: Setup, visit: Visit) -> tuple[Stance, ...]:
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
        walks = not thrusters.undriven_axes(setup.robot)
        stances = tuple(_aligned(stance, target, walks=walks) for stance in stances)
    landing = visit.active(LandingAltitude)
    if landing is not None:
        altitude = threshold_of(visit.phase, f"{landing.name}.altitude") or landing.rest_altitude
        height = setup.altimeter_height()
        positions = [stance.position for stance in stances]
        places = [(x, y, setup.floor_at(x, y) + altitude - height) for x, y, _ in positions]
        stances = tuple(
            replace(stance, position=np.array(place))
            for stance, place in zip(stances, places, strict=True)
        )
    return stances


def stances_at_way_point(
    goal: pin.SE3, radius: float, *, origin: np.ndarray, towards: np.ndarray | None = None
) -> tuple[Stance, ...]:
    """Stances in a ball of `radius` [m] around a way point.

    The first is where the straight way from `origin` (3,) [m] in W enters it.

    Likely are those too to either side of it, as currents and obstacles bend the way. Then come,
    merely possible, the centre and the rim, which begins in the direction of `towards` (3,) [m] in
    W.
    """
    yaw = float(pin.rpy.matrixToRpy(goal.rotation)[2])
    offset = origin - goal.translation
    arrival = offset * min(1.0, radius / max(float(np.linalg.norm(offset)), 1e-9))
    turned = (pin.rpy.rpyToMatrix(0.0, 0.0, angle) @ arrival for angle in (0.0, _BEND, -_BEND))
    likely = [Stance(position=goal.translation + point, yaw=yaw) for point in turned]
    if towards is None:
        x, y, _ = np.zeros(3)
    else:
        x, y, _ = towards - goal.translation
    R = pin.rpy.rpyToMatrix(0.0, 0.0, math.atan2(y, x))
    around = [goal.translation + R @ point for point in points_on_ball(np.zeros(3), radius)]
    possible = [Stance(position=point, yaw=yaw, likely=radius == 0) for point in around]
    if radius > 0:
        return (*likely, *possible)
    return tuple(possible)


def _next_target(setup: Setup, visit: Visit) -> np.ndarray | None:
    """Target of the alignment of this mission, towards and away from which reach is best and
    worst.
    """
    alignment = next(
        (task for task in setup.mission.tasks_of(visit.index) if isinstance(task, Alignment)), None
    )
    if alignment is None:
        return None
    return goals.evaluate_vector(alignment.name, alignment.goal, 0.0)[0]


def _aligned(stance: Stance, target: np.ndarray, *, walks: bool) -> Stance:
    """After turning to a target by the least motion: part of the turn is a walk around the target.

    With d the distance, ``d theta = -(d psi + ds / d)`` and the least ``d psi^2 + ds^2`` share the
    angle as d^2 : 1 between turning and walking. A vehicle that does not drive every axis turns on
    the spot.
    """
    offset = stance.position[:2] - target[:2]
    d = float(np.linalg.norm(offset))
    if d < _OVERHEAD:
        return stance
    bearing = math.atan2(-offset[1], -offset[0])
    theta = math.remainder(bearing - stance.yaw, 2 * math.pi)
    walk = -theta / (d**2 + 1.0) if walks else 0.0
    R = pin.rpy.rpyToMatrix(0.0, 0.0, walk)[:2, :2]
    return replace(
        stance,
        position=np.array([*(target[:2] + R @ offset), stance.position[2]]),
        yaw=bearing + walk,
    )
