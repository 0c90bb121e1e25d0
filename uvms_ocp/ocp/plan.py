"""Plans: a trajectory with a verdict, as a record and as a file, and how far a plant departed from
it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.model_errors import printable
from uvms_ocp.ocp import plan_file
from uvms_ocp.ocp.plan_file import LevelReport as LevelReport, VerdictReport
from uvms_ocp.ocp.plan_status import OcpStatus as OcpStatus
from uvms_ocp.ocp.trajectory import TOLERANCE, Trajectory, admissible_configurations
from uvms_ocp.planning.conservative_advancement import ClearanceReport
from uvms_ocp.planning.planned_axes import Coordinates, coordinates
from uvms_ocp.record.display import SmallTable, TableDisplay, rows_of
from uvms_ocp.record.meta_values import AxisLimitsMeta, PhaseMeta, SurroundingsMeta
from uvms_ocp.record.record import Record
from uvms_ocp.record.run_meta import PlanMeta, packages
from uvms_ocp.robot import Robot, list_robots, load_robot, recorded_robots
from uvms_ocp.robot.thrusters import joint_power, power_law
from uvms_ocp.solvers.nlp.lexicographic_nlp import LexicographicResult
from uvms_ocp.types import Array

TOOL = "tool"
_PERIOD = 0.02  # [s] between samples, longer where there would be more of them than this:
_MOST_SAMPLES = 5000

Powers = tuple[Array, Array]
"""[W] of every thruster (N, n_thrusters) and of every joint (N, n_joints) at the steps of a
trajectory.
"""

_STORED = ("reason", "levels", "solve_time", "surroundings", "current", "plugin", "verdict")
"""Fields of a plan that its file holds as they are."""


# How far a plant departed from a plan.


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackingError:
    """Departure of a plant from a plan."""

    position: float
    """[m] largest distance of the frame from its planned position."""
    end_position: float
    """[m] at the end."""
    end_orientation: float
    """[rad] at the end."""


def tracking_error(
    trajectory: Trajectory, t: np.ndarray, q: np.ndarray, *, robot: Robot, frame: str
) -> TrackingError:
    """The pose of a frame at the recorded q (n, n_q) [m, rad] against the planned one at the times
    t (n,) [s].

    Raises `FrameNotFound` for an unknown frame.
    """
    pairs = zip(
        frame_poses(robot, frame, trajectory.states_at(robot.model, t)[0]),
        frame_poses(robot, frame, q),
        strict=True,
    )
    errors = [wanted.inverse() * found for wanted, found in pairs]
    distances = [float(np.linalg.norm(error.translation)) for error in errors]
    angle = float(np.linalg.norm(pin.log3(errors[-1].rotation)))
    return TrackingError(position=max(distances), end_position=distances[-1], end_orientation=angle)


def frame_poses(robot: Robot, frame: str, q: np.ndarray) -> list[pin.SE3]:
    """X_WF at configurations q (n, n_q) [m, rad]. Raises `FrameNotFound` for an unknown frame."""
    data = robot.model.createData()
    index = robot.frame_id(frame)
    poses = []
    for configuration in q:
        pin.framesForwardKinematics(robot.model, data, configuration)
        poses.append(data.oMf[index].copy())
    return poses


# A trajectory sampled as the series of a record: states, the tool, forces, and the energy taken so
# far.


def sample_times(duration: float) -> Array:
    """Times (n,) [s] from 0 to `duration` [s], both included."""
    return np.linspace(
        0.0, duration, max(2, min(int(np.ceil(duration / _PERIOD)) + 1, _MOST_SAMPLES))
    )


def motion_series(
    robot: Robot, trajectory: Trajectory, powers: Powers, t: Array, q: Array
) -> dict[str, Array]:
    """Series of a record at times t (n,) [s], where the configurations are q (n, n_q) [m, rad].

    ``thrust`` (n, n_thrusters), or ``wrench`` (n, n_vehicle) of `Actuation.WRENCH`, and ``torque``
    (n, n_joints) are those of the steps; ``thruster_energy`` (n, n_thrusters) and ``joint_energy``
    (n,) [J] what was taken so far; ``tool`` (n, 7) [m, -] the pose X_WT where there is a tool.
    """
    _, v, steps = trajectory.states_at(robot.model, t)
    thrusters, joints = (_taken(trajectory.t, power, t) for power in powers)
    series: dict[str, Array] = {"t": t, "q": q, "v": v}
    if robot.has_frame(TOOL):
        series[TOOL] = tool_series(robot, q)
    return series | {
        "wrench" if trajectory.has_wrench else "thrust": trajectory.thrust[steps],
        "torque": trajectory.torque[steps],
        "thruster_energy": thrusters,
        "joint_energy": joints.sum(axis=1),
    }


def tool_series(robot: Robot, q: Array) -> Array:
    """(n, 7) [m, -] poses X_WT, quaternions xyzw, at configurations q (n, n_q) [m, rad]."""
    return np.array([pin.SE3ToXYZQUAT(pose) for pose in frame_poses(robot, TOOL, q)])


def axis_series(planned: Coordinates, x: Array, v: Array) -> dict[str, Array]:
    """``x`` (n, n_axes) [m, rad] and its rates [m/s, rad/s], where velocities are v (n, n_v) [m/s,
    rad/s].
    """
    return {
        "x": x,
        "x_rate": np.asarray(
            np.linalg.solve(planned.velocity_map(x), v[..., None])[..., 0], dtype=float
        ),
    }


def plan_record(
    robot: Robot,
    trajectory: Trajectory,
    powers: Powers,
    *,
    title: str,
    surroundings: SurroundingsMeta,
) -> Record:
    """The record of a plan of any problem. Axes are left out of robots whose joints are no single
    axes.
    """
    t = sample_times(float(trajectory.t[-1]))
    q = admissible_configurations(robot, trajectory.states_at(robot.model, t)[0], TOLERANCE)
    series = motion_series(robot, trajectory, powers, t, q)
    names: tuple[str, ...] = ()
    limits = AxisLimitsMeta(x_rate=())
    if all(joint.n_v == 1 for joint in robot.joints):
        planned = coordinates(robot)
        names = planned.names
        x = np.array([planned.x_beyond_limits(row) for row in q])
        x[:, planned.endless] = np.unwrap(x[:, planned.endless], axis=0)
        series |= axis_series(planned, x, series["v"])
        limits = AxisLimitsMeta(x_rate=tuple(planned.rate_limits(x)[0].tolist()))
    meta = PlanMeta(
        scenario=title,
        **recorded_robots.robot_meta(robot),
        phases=(PhaseMeta(name="plan"),),
        surroundings=surroundings,
        packages=packages(),
        axes=names,
        axis_limits=limits,
        breaks=(0.0, float(t[-1])),
        clearance_wanted=0.0,
    )
    return Record(series=series, meta=meta)


def _taken(nodes: Array, power: Array, t: Array) -> Array:
    """Integral (len(t), n) of powers (n_steps, n) that are constant between nodes."""
    total = np.vstack(
        [np.zeros(power.shape[1]), np.cumsum(np.diff(nodes)[:, None] * power, axis=0)]
    )
    return (
        np.array([np.interp(t, nodes, column) for column in total.T])
        .reshape(power.shape[1], len(t))
        .T
    )


# What planning returns: a trajectory with a verdict that says what to do.


@checked_dataclass(eq=False, repr=False)
class Plan(TableDisplay):
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
    """Certificate of constraints on true shapes: whether these certainly stay apart between nodes
    too, and where they are nearest.
    """
    surroundings: SurroundingsMeta = field(default_factory=SurroundingsMeta)
    """Goals, obstacles and floor of the problem, for records and scenes."""
    current: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """[m/s] of the water in W that was reckoned with."""
    plugin: str = ""
    """Which of `uvms_ocp.solvers.nlp.level_solver.PLUGINS` found it; empty where none was asked."""
    verdict: VerdictReport | None = None
    """Tolerances and resolution of the judge that gave the status, and what a step would still gain;
    `None` where nothing was planned.
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
        """[s]"""
        return float(self.trajectory.t[-1])

    @property
    def iterations(self) -> int:
        return sum(level.iterations for level in self.levels)

    @property
    def peak_thrust(self) -> float | None:
        """[N] Largest of any thruster; `None` where a wrench was planned."""
        if self.trajectory.has_wrench:
            return None
        return float(np.abs(self.trajectory.thrust).max(initial=0.0))

    def powers(self) -> tuple[np.ndarray, np.ndarray]:
        """Electrical power of every thruster (N, n_thrusters) and of every joint (N, n_joints) at
        the steps [W].

        NaN where it is not known: of thrusters without power data, and of the axes of a wrench (N,
        n_vehicle).
        """
        if self.trajectory.of_wrench:
            factor, exponent = np.array(np.nan), np.array(1.0)
        else:
            factor, exponent = power_law(self.robot)
        rates = self.trajectory.v[:, self.robot.joint_v]
        joints = joint_power(
            self.trajectory.torque,
            (rates[:-1] + rates[1:]) / 2,
            self.robot.description.joint_efficiency,
        )
        return factor * np.abs(self.trajectory.thrust) ** exponent, joints

    @property
    def energy(self) -> float | None:
        """[J] Electrical, of thrusters and joints; `None` where it is not known."""
        energy = float(np.diff(self.trajectory.t) @ np.hstack(self.powers()).sum(axis=1))
        if np.isnan(energy):
            return None
        return energy

    def summary(self) -> dict[str, Any]:
        """Plain numbers and texts, ready for JSON."""
        return {
            "status": self.status.value,
            "reason": self.reason,
            "advice": self.advice,
            "robot": self.robot.name,
            **{
                name: getattr(self, name)
                for name in ("duration", "energy", "peak_thrust", "iterations", "solve_time")
            },
            "levels": [
                {
                    "name": level.name,
                    "status": level.status,
                    "residual": level.residual,
                    "iterations": level.iterations,
                }
                for level in self.levels
            ],
        }

    def _table(self) -> SmallTable:
        values = {name: value for name, value in self.summary().items() if name != "levels"}
        levels = (
            (f"level {level.name}", f"{level.status}, residual {level.residual:.3g}")
            for level in self.levels
        )
        return SmallTable(title=f"Plan: {self.status.value}", rows=(*rows_of(values), *levels))

    def to_record(self) -> Record:
        """The motion as a record, which figures, scenes and comparisons take; see `motion_series`
        for what it holds.
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
        values = self.summary() | {
            name: getattr(self, name)
            for name in ("levels", "surroundings", "current", "plugin", "verdict")
        }
        values |= {
            "of_wrench": self.trajectory.of_wrench,
            "solver": None if self.result is None else plan_file.solver_values(self.result),
            "clearance": None
            if self.clearance is None
            else plan_file.clearance_values(self.clearance),
        }
        return plan_file.write_plan(
            Path(path), plan_file.PlanValues(**values), _arrays(self.trajectory, self.result)
        )

    @staticmethod
    def load(path: Path | str, robot: Robot | None = None) -> Plan:
        """A plan that `save` wrote, down to the last bit.

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
    return plan_file.trajectory_arrays(trajectory) | (
        {} if result is None else plan_file.result_arrays(result)
    )


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
    if values.solver is None:
        result = None
    else:
        result = plan_file.stored_result(values.solver, arrays)
    unknown = arrays.keys() - _arrays(trajectory, result).keys()
    if unknown:
        raise InvalidInput(f"array {min(unknown)[:60]!r} is none of a plan")
    return Plan(
        robot=robot,
        trajectory=trajectory,
        status=OcpStatus(values.status),  # type: ignore[call-arg]
        **{name: getattr(values, name) for name in _STORED},
        result=result,
        clearance=None
        if values.clearance is None
        else plan_file.stored_clearance(values.clearance),
    )
