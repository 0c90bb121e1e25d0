"""What planning returns: a trajectory with a verdict that says what to do."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.collision.conservative_advancement import ClearanceReport
from uvms_ocp.exceptions import OutputError
from uvms_ocp.model.robot import Robot
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.solvers.nlp.lexicographic_nlp import LexicographicResult
from uvms_ocp.status import AdvisedStatus


class OcpStatus(AdvisedStatus):
    """Verdict on a plan.

    MISSED: a goal is not met, and longer horizons were not tried. UNREACHABLE: they were, up to four times the time, and
    did not help. INFEASIBLE: the start is proven impossible, or the solver ended where no small change brings the
    constraints any nearer. UNFINISHED proves nothing.
    """

    SOLVED = "solved", "nothing to do"
    MISSED = (
        "goal missed",
        "why is not known: give it more time, move the goal, or loosen the constraints and levels above it",
    )
    TOO_SHORT = "horizon too short", "give the horizon more time, or loosen the limits"
    UNREACHABLE = (
        "unreachable",
        "more time would not help: move the goal, or loosen the constraints and levels above it",
    )
    INFEASIBLE = (
        "infeasible",
        "no motion near the guess keeps the constraints: loosen limits, weaken the current, or start slower",
    )
    OBSTRUCTED = (
        "obstructed start",
        "the start breaks a constraint: move the start or the obstacle, or lower the margin",
    )
    UNFINISHED = (
        "unfinished",
        "the solver stopped early: raise time_limit or max_iterations, loosen limits, or improve the guess",
    )

    @property
    def usable(self) -> bool:
        """True if the trajectory keeps all constraints; goals may still be missed."""
        return self in (OcpStatus.SOLVED, OcpStatus.MISSED, OcpStatus.TOO_SHORT, OcpStatus.UNREACHABLE)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LevelReport:
    """How one level came out."""

    name: str
    status: str
    advice: str
    residual: float
    """[-] Norm of the distances of its weighted rows to their range."""
    iterations: int


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Plan:
    """States at nodes, inputs of steps, and how it came about."""

    robot: Robot
    trajectory: Trajectory
    status: OcpStatus
    reason: str
    """With the level or constraint and the numbers behind the verdict."""
    levels: tuple[LevelReport, ...]
    solve_time: float
    """[s]"""
    result: LexicographicResult | None = None
    """Start of the next, warm solve."""
    clearance: ClearanceReport | None = None
    """Of constraints on true shapes: whether these certainly stay apart between nodes too, and where they are nearest."""

    @property
    def certified_free(self) -> bool:
        """True if it is proven that nothing touches: by true shapes, along the motion between the nodes too."""
        return self.clearance is not None and self.clearance.collision_free

    @property
    def advice(self) -> str:
        """What to change."""
        return self.status.advice

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self.trajectory.t[-1])

    @property
    def iterations(self) -> int:
        return sum(level.iterations for level in self.levels)

    @property
    def peak_thrust(self) -> float:
        """[N] Largest of any thruster."""
        return float(np.abs(self.trajectory.thrust).max(initial=0.0))

    def powers(self) -> tuple[np.ndarray, np.ndarray]:
        """Electrical power of every thruster (N, n_thrusters) and of every joint (N, n_joints) at the steps [W].

        NaN where it is not known: of thrusters without power data, and of the axes of a wrench (N, n_vehicle).
        """
        description, thrust = self.robot.description, np.abs(self.trajectory.thrust)
        thrusters = np.full_like(thrust, np.nan)
        if not self.trajectory.of_wrench:
            for i, thruster in enumerate(description.thrusters):
                if thruster.power is not None:
                    share = thrust[:, i] / thruster.power.thrust
                    thrusters[:, i] = thruster.power.watts * share**thruster.power.exponent
        rates = self.trajectory.v[:, self.robot.joint_v]
        middle = (rates[:-1] + rates[1:]) / 2
        return thrusters, np.abs(self.trajectory.torque * middle) / description.joint_efficiency

    @property
    def energy(self) -> float | None:
        """[J] Electrical, of thrusters and joints; `None` where it is not known."""
        energy = float(np.diff(self.trajectory.t) @ np.hstack(self.powers()).sum(axis=1))
        return None if np.isnan(energy) else energy

    def summary(self) -> dict[str, Any]:
        """Plain numbers and texts, ready for JSON."""
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
            "levels": [
                {"name": level.name, "status": level.status, "residual": level.residual, "iterations": level.iterations}
                for level in self.levels
            ],
        }

    def save(self, path: Path | str) -> Path:
        """Write the trajectory and the summary as ``.npz``; with the suffix ``.json`` all of it as text.

        Raises `OutputError` where the file cannot be written.
        """
        target = Path(path)
        t = self.trajectory
        arrays = {"t": t.t, "q": t.q, "v": t.v, "a": t.a, "thrust": t.thrust, "torque": t.torque}
        try:
            if target.suffix == ".json":
                lists = {name: array.tolist() for name, array in arrays.items()}
                target.write_text(json.dumps({**self.summary(), **lists}), encoding="utf-8")
            else:
                target = target.with_suffix(".npz")
                np.savez(target, allow_pickle=False, summary=np.array(json.dumps(self.summary())), **arrays)
        except OSError as error:
            raise OutputError(f"cannot write {target}: {error.strerror}; choose another place") from error
        return target
