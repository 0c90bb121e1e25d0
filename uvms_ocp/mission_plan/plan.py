"""Plans of whole missions: a motion, when it takes the phases, which mission it is of, and their files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.control.plan_following import FollowingTuning, PlanGuide, PlannedPhase
from uvms_ocp.errors import InvalidInput
from uvms_ocp.mission.mission import Mission
from uvms_ocp.model_errors import printable
from uvms_ocp.ocp import OcpStatus, Plan, Trajectory
from uvms_ocp.ocp.plan_file import Arrays, from_arrays, trajectory_arrays, write_arrays
from uvms_ocp.record.display import SmallTable, TableDisplay, rows_of
from uvms_ocp.record.record import Record
from uvms_ocp.robot.robot import Robot
from uvms_ocp.scenario.scenario import MissionController, Scenario
from uvms_ocp.sim.loop import Progress
from uvms_ocp.tasks.task import Task
from uvms_ocp.types import Count, Finite, Magnitude

# What tells one mission from another: digests that a saved plan is checked by.

_MOMENTS = (0.0, 1.0, 7.0)  # [s] at which goals are looked at
_DIGITS = 9
_PLAIN = (bool, int, float, str, tuple)


@checked
def mission_digests(scenario: Scenario) -> dict[str, str]:
    """Return digests of the robot, the start and the mission of a scenario, by these names."""
    return {
        "robot": _digest(_of_robot(scenario.robot)),
        "start": _digest([_rounded(scenario.start)]),
        "mission": _digest(_of_mission(scenario.mission)),
    }


def _digest(parts: list[str] | Iterator[str]) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def _of_robot(robot: Robot) -> Iterator[str]:
    yield from (robot.name, *robot.model.names)
    for inertia, placement in zip(robot.model.inertias, robot.model.jointPlacements, strict=True):
        yield _rounded(inertia.toDynamicParameters())
        yield _rounded(placement.homogeneous)
    limits = robot.limits
    for item in fields(limits):
        yield _rounded(getattr(limits, item.name))
    yield repr(robot.description.thrusters)


def _of_mission(mission: Mission) -> Iterator[str]:
    for index, phase in enumerate(mission.phases):
        yield from (phase.name, repr(sorted(phase.activations.items())), repr(phase.transitions))
        for task in mission.tasks_of(index):
            if phase.activations.get(task.name, 0.0) > 0:
                yield from _of_task(task)


def _of_task(task: Task) -> Iterator[str]:
    yield type(task).__name__
    for item in fields(task):
        value = getattr(task, item.name)
        if isinstance(value, _PLAIN):
            yield f"{item.name}={value!r}"
    for t in _MOMENTS:
        yield _rounded(task.reference(t))


def _rounded(values: np.ndarray) -> str:
    return np.array2string(np.round(np.asarray(values, dtype=float), _DIGITS) + 0.0, threshold=np.inf)  # type: ignore[arg-type]


# Plans of missions as files.

_KEY = "mission_plan"
_NO_PLAN = "no plan of a mission"
_ARRAYS = {"t": 0, "q": 0, "v": 0, "a": 1, "thrust": 1, "torque": 1}
"""Arrays, with the number of rows by which each is shorter than there are times."""


def write_plan(path: Path | str, trajectory: Trajectory, summary: dict[str, Any]) -> Path:
    """Arrays as they are, the summary as text. Raises `OutputError`."""
    return write_arrays(Path(path), _KEY, json.dumps(summary), trajectory_arrays(trajectory))


def read_plan(path: Path | str) -> tuple[Trajectory, dict[str, Any]]:
    """Read a file that anyone may have written. Raises `InvalidInput`."""
    summary, arrays = from_arrays(Path(path), _KEY, _NO_PLAN)
    if not set(_ARRAYS) <= arrays.keys():
        raise InvalidInput(_NO_PLAN)
    own = {name: arrays[name] for name in _ARRAYS}
    _check(own)
    return Trajectory(**own, of_wrench=False), summary


def _check(arrays: Arrays) -> None:
    n = arrays["t"].size
    for name, array in arrays.items():
        flat = array.ndim == 1 + (name != "t") and array.dtype.kind == "f"
        if not flat or len(array) != n - _ARRAYS[name] or not np.isfinite(array).all():
            raise InvalidInput(f"{name} of shape {array.shape} does not fit {n} times, or is not finite")
    if n < 2 or not (np.diff(arrays["t"]) > 0).all():
        raise InvalidInput("its times do not increase")


# A plan of a whole mission: a motion, when it takes the phases, and which mission it is of.


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class MissionPlan(TableDisplay):
    """Plan of a whole mission, as `plan_mission` returns it."""

    scenario: str
    """Its name."""
    trajectory: Trajectory
    phases: tuple[PlannedPhase, ...]
    """On the way, in their order."""
    names: tuple[str, ...]
    """Names of these phases."""
    status: OcpStatus
    reason: str
    """With the numbers behind the verdict."""
    energy: Magnitude | None
    """[J] electrical, of thrusters and joints; `None` where it is not known."""
    clearance: Finite | None
    """[m] Least between links, and to obstacles; `None` where there is no pair."""
    greedy_duration: Magnitude
    """[s] of the greedy mission in still water, without forces."""
    iterations: Count
    solve_time: Magnitude
    """[s]"""
    identity: Mapping[str, str]
    """Digests of the robot, the start and the mission."""

    @property
    def solved(self) -> bool:
        """Every phase ends as the mission asks for."""
        return self.status is OcpStatus.SOLVED

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self.trajectory.t[-1])

    @property
    def peak_thrust(self) -> float:
        """[N] Largest of any thruster."""
        return float(np.abs(self.trajectory.thrust).max(initial=0.0))

    def summary(self) -> dict[str, Any]:
        """Plain numbers and texts, ready for JSON."""
        return {
            "scenario": self.scenario,
            "status": self.status.value,
            "reason": self.reason,
            "advice": self.status.advice,
            "duration_s": self.duration,
            "greedy_duration_s": self.greedy_duration,
            "energy_j": self.energy,
            "clearance_m": self.clearance,
            "peak_thrust_n": self.peak_thrust,
            "iterations": self.iterations,
            "solve_time_s": self.solve_time,
            "phases": [
                {"name": name, "phase": part.phase, "begin_s": part.begin, "end_s": part.end, "moves": part.moves}
                for name, part in zip(self.names, self.phases, strict=True)
            ],
            "identity": dict(self.identity),
        }

    def _table(self) -> SmallTable:
        summary = {name: value for name, value in self.summary().items() if name not in ("phases", "identity")}
        phases = zip(self.names, self.phases, strict=True)
        rows = ((f"phase {name}", f"{part.begin:.2f} to {part.end:.2f} s") for name, part in phases)
        return SmallTable(title=f"MissionPlan of {self.scenario}: {self.status.value}", rows=(*rows_of(summary), *rows))

    def to_record(self, scenario: Scenario) -> Record:
        """The motion of the scenario's robot as a record, which figures, scenes and comparisons take.

        Raises `InvalidInput` as `require_of` does.
        """
        self.require_of(scenario)
        return Plan(
            robot=scenario.robot,
            trajectory=self.trajectory,
            status=self.status,
            reason=self.reason,
            levels=(),
            solve_time=self.solve_time,
        ).to_record()

    def save(self, path: Path | str) -> Path:
        """Write it as ``.npz``. Raises `OutputError` where the file cannot be written."""
        return write_plan(path, self.trajectory, self.summary())

    @staticmethod
    def load(path: Path | str) -> MissionPlan:
        """Read a file written by `save`. Raises `InvalidInput`, in one line, for what is no such file."""
        try:
            return _from_summary(*read_plan(path))
        except InvalidInput as error:
            raise InvalidInput(f"{printable(path)}: {error}; give the plan.npz that `plan mission` wrote") from error
        except (KeyError, TypeError, ValueError) as error:
            raise InvalidInput(
                f"{printable(path)}: its summary lacks or garbles {error}; plan the mission anew"
            ) from error

    def require_of(self, scenario: Scenario) -> None:
        """Raise `InvalidInput` unless this is a plan of that scenario, and can be flown."""
        if not self.status.usable:
            raise InvalidInput(f"the plan of {self.scenario} is {self.status.value}; {self.status.advice}")
        own = mission_digests(scenario)
        other = [name for name, digest in own.items() if self.identity.get(name) != digest]
        if other:
            raise InvalidInput(
                f"the plan is of {self.scenario} with another {' and '.join(other)} than {scenario.name}; "
                f"plan {scenario.name} with the same options, or fly it without a plan"
            )

    def guide(self, scenario: Scenario, tuning: FollowingTuning | None = None) -> PlanGuide:
        """Return the guide of a scenario's controller along the plan, for one run. Raises `InvalidInput` as `require_of` does."""
        self.require_of(scenario)
        mission, robot = scenario.mission, scenario.robot
        return PlanGuide(self.trajectory, self.phases, mission, robot, dt=scenario.dt, tuning=tuning)

    def controller(self, scenario: Scenario, tuning: FollowingTuning | None = None) -> MissionController:
        """A fresh one for `Scenario.run`: the hierarchy's, led by `guide`."""
        return scenario.guided(self.guide(scenario, tuning))

    def fly(
        self, scenario: Scenario, progress: Progress | None = None, *, tuning: FollowingTuning | None = None
    ) -> Record:
        """Run the scenario along the plan; where that is left, the hierarchy takes over, and an alarm says when and why."""
        return scenario.run(progress, self.controller(scenario, tuning))


def _from_summary(trajectory: Trajectory, summary: dict[str, Any]) -> MissionPlan:
    """Build a plan from a file's summary, as `MissionPlan.summary` has it."""
    statuses = {status.value: status for status in OcpStatus}
    parts = [
        PlannedPhase(phase=part["phase"], begin=part["begin_s"], end=part["end_s"], moves=part["moves"])
        for part in summary["phases"]
    ]
    return MissionPlan(
        scenario=summary["scenario"],
        trajectory=trajectory,
        phases=tuple(parts),
        names=tuple(part["name"] for part in summary["phases"]),
        status=statuses[summary["status"]],
        reason=summary["reason"],
        energy=summary["energy_j"],
        clearance=summary["clearance_m"],
        greedy_duration=summary["greedy_duration_s"],
        iterations=summary["iterations"],
        solve_time=summary["solve_time_s"],
        identity=summary["identity"],
    )
