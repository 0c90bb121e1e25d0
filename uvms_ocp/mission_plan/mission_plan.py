"""Plan of a whole mission: a motion, when it takes the phases, and which mission it is of. As a
file it is an ``.npz`` with the arrays of the motion and a text of all else.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.control.plan_following import FollowingTuning, PlanGuide, PlannedPhase
from uvms_ocp.errors import InvalidInput
from uvms_ocp.mission_plan.mission_digests import mission_digests
from uvms_ocp.model_errors import printable
from uvms_ocp.ocp import OcpStatus, Plan, Trajectory, plan_file
from uvms_ocp.record.display import SmallTable, TableDisplay, rows_of
from uvms_ocp.record.record import Record
from uvms_ocp.scenario.part_factories import MissionController
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.loop import Progress
from uvms_ocp.types import Count, Finite, Magnitude

_TEXT = "mission_plan"  # name of the text in a file
_NO_PLAN = "no plan of a mission"
_SHORTER_BY = {"t": 0, "q": 0, "v": 0, "a": 1, "thrust": 1, "torque": 1}
"""Rows by which each array of a file is shorter than there are times."""


@checked_dataclass(eq=False, repr=False)
class MissionPlan(TableDisplay):
    """Plan of a whole mission, as `plan_mission` returns it."""

    scenario: str
    """Name of the scenario."""
    trajectory: Trajectory
    phases: tuple[PlannedPhase, ...]
    """Phases on the way, in their order."""
    names: tuple[str, ...]
    """Names of these phases."""
    status: OcpStatus
    reason: str
    """Reason of the status, with the numbers behind it."""
    energy: Magnitude | None
    """[J] electrical, of thrusters and joints; `None` where it is not known."""
    clearance: Finite | None
    """[m] Least distance between links, and to obstacles; `None` where there is no pair."""
    greedy_duration: Magnitude
    """[s] duration of the greedy mission in still water, without forces."""
    iterations: Count
    solve_time: Magnitude
    """[s] time that the search took."""
    identity: Mapping[str, str]
    """Digests of the robot, the start and the mission."""

    @property
    def solved(self) -> bool:
        """True where every phase ends as the mission asks for."""
        return self.status is OcpStatus.SOLVED

    @property
    def duration(self) -> float:
        """[s] Duration of the whole motion."""
        return float(self.trajectory.t[-1])

    @property
    def peak_thrust(self) -> float:
        """[N] Largest of any thruster."""
        return float(np.abs(self.trajectory.thrust).max(initial=0.0))

    def summary(self) -> dict[str, Any]:
        """Return the plan's figures as plain numbers and texts, ready for JSON."""
        phases = []
        for name, phase in zip(self.names, self.phases, strict=True):
            phases.append(
                {
                    "name": name,
                    "phase": phase.phase,
                    "begin_s": phase.begin,
                    "end_s": phase.end,
                    "moves": phase.moves,
                }
            )
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
            "phases": phases,
            "identity": dict(self.identity),
        }

    def _table(self) -> SmallTable:
        summary = self.summary()
        del summary["phases"]
        del summary["identity"]
        rows = list(rows_of(summary))
        for name, phase in zip(self.names, self.phases, strict=True):
            rows.append((f"phase {name}", f"{phase.begin:.2f} to {phase.end:.2f} s"))
        return SmallTable(
            title=f"MissionPlan of {self.scenario}: {self.status.value}", rows=tuple(rows)
        )

    def to_record(self, scenario: Scenario) -> Record:
        """Return the motion of the scenario's robot as a record, which figures, scenes and
        comparisons take.

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
        arrays = plan_file.trajectory_arrays(self.trajectory)
        return plan_file.write_arrays(Path(path), _TEXT, json.dumps(self.summary()), arrays)

    @staticmethod
    def load(path: Path | str) -> MissionPlan:
        """Read a file written by `save`. Raises `InvalidInput`, in one line, for what is no such
        file.
        """
        try:
            summary, arrays = plan_file.from_arrays(Path(path), _TEXT, _NO_PLAN)
            return _from_summary(_stored_trajectory(arrays), summary)
        except InvalidInput as error:
            raise InvalidInput(
                f"{printable(path)}: {error}; give the plan.npz that `plan mission` wrote"
            ) from error
        except (KeyError, TypeError, ValueError) as error:
            raise InvalidInput(
                f"{printable(path)}: its summary lacks or garbles {error}; plan the mission anew"
            ) from error

    def require_of(self, scenario: Scenario) -> None:
        """Raise `InvalidInput` unless this is a plan of that scenario, and can be flown."""
        if not self.status.usable:
            raise InvalidInput(
                f"the plan of {self.scenario} is {self.status.value}; {self.status.advice}"
            )
        differing_parts = []
        for name, digest in mission_digests(scenario).items():
            if self.identity.get(name) != digest:
                differing_parts.append(name)
        if differing_parts:
            mismatch = (
                f"the plan is of {self.scenario} with another {' and '.join(differing_parts)} than"
                f" {scenario.name}"
            )
            raise InvalidInput(
                f"{mismatch}; plan {scenario.name} with the same options, or fly it without a plan"
            )

    def guide(self, scenario: Scenario, tuning: FollowingTuning | None = None) -> PlanGuide:
        """Return the guide of a scenario's controller along the plan, for one run. Raises
        `InvalidInput` as `require_of` does.
        """
        self.require_of(scenario)
        return PlanGuide(
            self.trajectory,
            self.phases,
            scenario.mission,
            scenario.robot,
            dt=scenario.dt,
            tuning=tuning,
            energy=self.energy,
        )

    def controller(
        self, scenario: Scenario, tuning: FollowingTuning | None = None
    ) -> MissionController:
        """Make a controller for one `Scenario.run`: the hierarchy's, led by `guide`."""
        return scenario.guided(self.guide(scenario, tuning))

    def fly(
        self,
        scenario: Scenario,
        progress: Progress | None = None,
        *,
        tuning: FollowingTuning | None = None,
    ) -> Record:
        """Run the scenario along the plan; where that is left, the hierarchy takes over, and an
        alarm says when and why.
        """
        return scenario.run(progress, self.controller(scenario, tuning))


def _from_summary(trajectory: Trajectory, summary: dict[str, Any]) -> MissionPlan:
    """Build a plan from a file's summary, as `MissionPlan.summary` has it."""
    statuses = {status.value: status for status in OcpStatus}
    names = []
    phases = []
    for part in summary["phases"]:
        names.append(part["name"])
        phases.append(
            PlannedPhase(
                phase=part["phase"], begin=part["begin_s"], end=part["end_s"], moves=part["moves"]
            )
        )
    return MissionPlan(
        scenario=summary["scenario"],
        trajectory=trajectory,
        phases=tuple(phases),
        names=tuple(names),
        status=statuses[summary["status"]],
        reason=summary["reason"],
        energy=summary["energy_j"],
        clearance=summary["clearance_m"],
        greedy_duration=summary["greedy_duration_s"],
        iterations=summary["iterations"],
        solve_time=summary["solve_time_s"],
        identity=summary["identity"],
    )


def _stored_trajectory(arrays: plan_file.Arrays) -> Trajectory:
    """Build the motion from the arrays of a file, which anyone may have written. Raises
    `InvalidInput` where they are no motion.
    """
    if not arrays.keys() >= _SHORTER_BY.keys():
        raise InvalidInput(_NO_PLAN)
    series = {name: arrays[name] for name in _SHORTER_BY}
    n = series["t"].size
    for name, array in series.items():
        n_axes = 1 if name == "t" else 2
        has_axes = array.ndim == n_axes and array.dtype.kind == "f"
        if not has_axes or len(array) != n - _SHORTER_BY[name] or not np.isfinite(array).all():
            raise InvalidInput(
                f"{name} of shape {array.shape} does not fit {n} times, or is not finite"
            )
    if n < 2 or not (np.diff(series["t"]) > 0).all():
        raise InvalidInput("its times do not increase")
    return Trajectory(**series, of_wrench=False)
