"""Plans: a trajectory with a verdict that says what to do, as a record and as a file."""

from __future__ import annotations

from dataclasses import field
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.model_errors import printable
from uvms_ocp.ocp import plan_file
from uvms_ocp.ocp.motion_record import plan_record
from uvms_ocp.ocp.plan_file import LevelReport as LevelReport, VerdictReport
from uvms_ocp.ocp.plan_status import OcpStatus as OcpStatus
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.planning.conservative_advancement import ClearanceReport
from uvms_ocp.record.display import SmallTable, TableDisplay, rows_of
from uvms_ocp.record.meta_values import SurroundingsMeta
from uvms_ocp.record.record import Record
from uvms_ocp.robot import Robot, list_robots, load_robot
from uvms_ocp.robot.electrical_power import joint_power, power_law
from uvms_ocp.solvers.nlp.lexicographic_nlp import LexicographicResult


@checked_dataclass(eq=False, repr=False)
class Plan(TableDisplay):
    """States at nodes, inputs of steps, and how it came about."""

    robot: Robot
    trajectory: Trajectory
    status: OcpStatus
    reason: str
    """Reason of the verdict, with the level or constraint and the numbers behind it."""
    levels: tuple[LevelReport, ...]
    """Outcome of each level."""
    solve_time: float
    """[s] time of the solver."""
    result: LexicographicResult | None = None
    """Result of the solver, from which the next solve may start."""
    clearance: ClearanceReport | None = None
    """Certificate of constraints on true shapes: whether these certainly stay apart between nodes
    too, and where they are nearest.
    """
    surroundings: SurroundingsMeta = field(default_factory=SurroundingsMeta)
    """Goals, obstacles and floor of the problem, for records and scenes."""
    current: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """[m/s] Velocity of the water in W that was reckoned with."""
    plugin: str = ""
    """Name of the one of `uvms_ocp.solvers.nlp.options.PLUGINS` that found the plan; empty
    where none was asked.
    """
    verdict: VerdictReport | None = None
    """Tolerances and resolution of the judge that gave the status, and what a step would still
    gain; `None` where nothing was planned.
    """

    @property
    def certified_free(self) -> bool:
        """True if it is proven that nothing touches: by true shapes, along the motion between the
        nodes too.

        Of links without a shape, which ``clearance.unshaped`` names, nothing is proven.
        """
        return self.clearance is not None and self.clearance.collision_free

    @property
    def advice(self) -> str:
        """Advise what to change."""
        return self.status.advice

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.trajectory.t[-1])

    @property
    def iterations(self) -> int:
        """Iterations of all levels."""
        return sum(level.iterations for level in self.levels)

    @property
    def peak_thrust(self) -> float | None:
        """Largest thrust [N] of any thruster; `None` where a wrench was planned."""
        if self.trajectory.has_wrench:
            return None
        return float(np.abs(self.trajectory.thrust).max(initial=0.0))

    def powers(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the electrical power of every thruster (N, n_thrusters) and of every joint (N,
        n_joints) at the steps [W].

        NaN where it is not known: of thrusters without power data, and of the axes of a wrench (N,
        n_vehicle).
        """
        if self.trajectory.of_wrench:
            factor = np.array(np.nan)
            exponent = np.array(1.0)
        else:
            factor, exponent = power_law(self.robot)
        thruster_powers = factor * np.abs(self.trajectory.thrust) ** exponent
        rates = self.trajectory.v[:, self.robot.joint_v]
        mean_rates = (rates[:-1] + rates[1:]) / 2
        efficiency = self.robot.description.joint_efficiency
        joint_powers = joint_power(self.trajectory.torque, mean_rates, efficiency)
        return thruster_powers, joint_powers

    @property
    def energy(self) -> float | None:
        """Electrical energy [J] of thrusters and joints; `None` where it is not known."""
        total_power = np.hstack(self.powers()).sum(axis=1)
        energy = float(np.diff(self.trajectory.t) @ total_power)
        if np.isnan(energy):
            return None
        return energy

    def summary(self) -> dict[str, Any]:
        """Return plain numbers and texts, ready for JSON."""
        levels = []
        for level in self.levels:
            level_summary = {
                "name": level.name,
                "status": level.status,
                "residual": level.residual,
                "iterations": level.iterations,
            }
            levels.append(level_summary)
        return {
            "status": self.status.value,
            "reason": self.reason,
            "advice": self.advice,
            "robot": self.robot.name,
            "duration": self.duration,
            "energy": self.energy,
            "peak_thrust": self.peak_thrust,
            "iterations": self.iterations,
            "solve_time": self.solve_time,
            "levels": levels,
        }

    def _table(self) -> SmallTable:
        values = self.summary()
        del values["levels"]
        rows = list(rows_of(values))
        for level in self.levels:
            rows.append((f"level {level.name}", f"{level.status}, residual {level.residual:.3g}"))
        return SmallTable(title=f"Plan: {self.status.value}", rows=tuple(rows))

    def to_record(self) -> Record:
        """Return the motion as a record, which figures, scenes and comparisons take; see
        `motion_series` for what it holds.
        """
        title = f"plan by optimal control, {self.status.value}"
        return plan_record(
            self.robot, self.trajectory, self.powers(), title=title, surroundings=self.surroundings
        )

    def save(self, path: Path | str) -> Path:
        """Write all of it as ``.npz``, or with the suffix ``.json`` as text; `load` gives it back
        exactly.

        Raises `OutputError` where the file cannot be written.
        """
        values = self.summary()
        values["levels"] = self.levels
        values["surroundings"] = self.surroundings
        values["current"] = self.current
        values["plugin"] = self.plugin
        values["verdict"] = self.verdict
        values["of_wrench"] = self.trajectory.of_wrench
        if self.result is not None:
            values["solver"] = plan_file.solver_values(self.result)
        if self.clearance is not None:
            values["clearance"] = plan_file.clearance_values(self.clearance)
        arrays = _arrays(self.trajectory, self.result)
        return plan_file.write_plan(Path(path), plan_file.PlanValues(**values), arrays)

    @staticmethod
    def load(path: Path | str, robot: Robot | None = None) -> Plan:
        """Read a plan that `save` wrote, down to the last bit.

        robot: by default that of the same name in the library. Raises `InvalidInput`, in one line,
        for what is no such file, is damaged, or is of another robot.
        """
        values, arrays = plan_file.read_plan(Path(path))
        try:
            return _plan_of(values, arrays, robot or _robot_of(values))
        except (InvalidInput, ValueError) as error:
            raise InvalidInput(
                f"{printable(str(path))}: not a plan written by uvms_ocp: {error}"
            ) from error


def _arrays(trajectory: Trajectory, result: LexicographicResult | None) -> dict[str, np.ndarray]:
    arrays = plan_file.trajectory_arrays(trajectory)
    if result is not None:
        arrays |= plan_file.result_arrays(result)
    return arrays


def _robot_of(values: plan_file.PlanValues) -> Robot:
    if values.robot not in list_robots():
        raise InvalidInput(
            f"robot {values.robot[:60]!r} is not in the library; give it: --robot DIR, or"
            " Plan.load(path, robot)"
        )
    return load_robot(values.robot)


def _plan_of(values: plan_file.PlanValues, arrays: dict[str, np.ndarray], robot: Robot) -> Plan:
    if robot.name != values.robot:
        raise InvalidInput(f"a plan of robot {values.robot[:60]!r}, not of {robot.name!r}")
    trajectory = plan_file.stored_trajectory(robot, arrays, of_wrench=values.of_wrench)
    result = None
    if values.solver is not None:
        result = plan_file.stored_result(values.solver, arrays)
    clearance = None
    if values.clearance is not None:
        clearance = plan_file.stored_clearance(values.clearance)
    unknown = arrays.keys() - _arrays(trajectory, result).keys()
    if unknown:
        raise InvalidInput(f"array {min(unknown)[:60]!r} is none of a plan")
    return Plan(
        robot=robot,
        trajectory=trajectory,
        status=OcpStatus(values.status),  # type: ignore[call-arg]
        reason=values.reason,
        levels=values.levels,
        solve_time=values.solve_time,
        surroundings=values.surroundings,
        current=values.current,
        plugin=values.plugin,
        verdict=values.verdict,
        result=result,
        clearance=clearance,
    )
