"""A plan of a whole mission: a motion, when it takes the phases, and which mission it is of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.arguments import Count, Finite, Magnitude, checked
from uvms_ocp.control.receding.plan_guide import FollowingTuning, PlanGuide, PlannedPhase
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.mission_plan.identity import digests
from uvms_ocp.mission_plan.saved import read_plan, write_plan
from uvms_ocp.ocp.plan import OcpStatus, Plan
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.record import Record
from uvms_ocp.scenario import MissionController, Scenario
from uvms_ocp.shown.small_table import SmallTable, Tabled, rows_of
from uvms_ocp.sim.loop import Progress
from uvms_ocp.validation import shown


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class MissionPlan(Tabled):
    """What `plan_mission` returns."""

    scenario: str
    """Its name."""
    trajectory: Trajectory
    phases: tuple[PlannedPhase, ...]
    """On the way, in their order."""
    names: tuple[str, ...]
    """Of these phases."""
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
    """What it was made for, as digests."""

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
        told = {name: value for name, value in self.summary().items() if name not in ("phases", "identity")}
        phases = zip(self.names, self.phases, strict=True)
        rows = ((f"phase {name}", f"{part.begin:.2f} to {part.end:.2f} s") for name, part in phases)
        return SmallTable(title=f"MissionPlan of {self.scenario}: {self.status.value}", rows=(*rows_of(told), *rows))

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
            return _made(*read_plan(path))
        except InvalidInput as error:
            raise InvalidInput(f"{shown(path)}: {error}; give the plan.npz that `plan mission` wrote") from error
        except (KeyError, TypeError, ValueError) as error:
            raise InvalidInput(f"{shown(path)}: its summary lacks or garbles {error}; plan the mission anew") from error

    def require_of(self, scenario: Scenario) -> None:
        """Raise `InvalidInput` unless this is a plan of that scenario, and can be flown."""
        if not self.status.usable:
            raise InvalidInput(f"the plan of {self.scenario} is {self.status.value}; {self.status.advice}")
        own = digests(scenario)
        other = [name for name, digest in own.items() if self.identity.get(name) != digest]
        if other:
            raise InvalidInput(
                f"the plan is of {self.scenario} with another {' and '.join(other)} than {scenario.name}; "
                f"plan {scenario.name} with the same options, or fly it without a plan"
            )

    def guide(self, scenario: Scenario, tuning: FollowingTuning | None = None) -> PlanGuide:
        """What leads the controller of a scenario along the plan, for one run. Raises `InvalidInput` as `require_of` does."""
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


def _made(trajectory: Trajectory, told: dict[str, Any]) -> MissionPlan:
    """From what a file tells, as `MissionPlan.summary` has it."""
    statuses = {status.value: status for status in OcpStatus}
    parts = [
        PlannedPhase(phase=part["phase"], begin=part["begin_s"], end=part["end_s"], moves=part["moves"])
        for part in told["phases"]
    ]
    return MissionPlan(
        scenario=told["scenario"],
        trajectory=trajectory,
        phases=tuple(parts),
        names=tuple(part["name"] for part in told["phases"]),
        status=statuses[told["status"]],
        reason=told["reason"],
        energy=told["energy_j"],
        clearance=told["clearance_m"],
        greedy_duration=told["greedy_duration_s"],
        iterations=told["iterations"],
        solve_time=told["solve_time_s"],
        identity=told["identity"],
    )
