"""Case 1 on the physical plant, greedy and as one plan: what it costs and how its phases end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from recording.report import Row

from horizon.tracking import tracked
from uvms_ocp.model.robot import Robot
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.report.resources import resources
from uvms_ocp.scenario import Scenario
from uvms_ocp.scenarios.case1 import Thresholds

FORMATS = {
    "mission": "",
    "duration [s]": ".4g",
    "energy of thrusters [J]": ".4g",
    "energy of joints [J]": ".4g",
    "peak thrust [N]": ".4g",
    "largest tilt [rad]": ".4g",
    "tool off at the end [mm]": ".4g",
}
_EVERY = 10  # ticks between two configurations that are looked at


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Place:
    """Where Case 1 happens."""

    way_point: pin.SE3
    """X_WB that ends A."""
    target: np.ndarray
    """(3,) [m] in W."""
    floor: float
    """[m]"""


def greedy(scenario: Scenario, place: Place) -> Row:
    """Phase after phase, by the velocity hierarchy and the dynamic layer."""
    record = scenario.run()
    *_, total = resources(record)
    return {
        "mission": "greedy",
        "duration [s]": float(record["t"][-1]),
        "energy of thrusters [J]": total["thruster_energy_j"],
        "energy of joints [J]": total["joint_energy_j"],
        "peak thrust [N]": total["peak_thrust_n"],
        "largest tilt [rad]": max(tilt_of(q) for q in record["q"]),
        "tool off at the end [mm]": 1e3 * tool_error(scenario.robot, record["q"][-1], place),
    }


def carried_out(scenario: Scenario, plan: Plan, place: Place) -> tuple[Row, np.ndarray]:
    """What the plan costs, and how it ends; and q (n, n_q) after every tick."""
    series = tracked(scenario.robot, plan.trajectory, scenario.environment, dt=scenario.dt, duration=plan.duration)
    way = series["q"][1:]
    row = {
        "mission": "one problem",
        "duration [s]": plan.duration,
        "energy of thrusters [J]": float(series["thruster_energy"][-1].sum()),
        "energy of joints [J]": float(series["joint_energy"][-1]),
        "peak thrust [N]": float(np.abs(series["thrust"]).max()),
        "largest tilt [rad]": max(tilt_of(q) for q in way),
        "tool off at the end [mm]": 1e3 * tool_error(scenario.robot, way[-1], place),
    }
    return row, way


def ends_of_phases(
    robot: Robot, way: np.ndarray, ends: Sequence[int], place: Place, asked: Thresholds, altitude: float
) -> str:
    """How the phases end along a way of q (n, n_q), beside what Case 1 asks for; altitude [m]: the least in A and B."""
    data, (a, b, c) = robot.model.createData(), ends

    def pose(q: np.ndarray, frame: str) -> pin.SE3:
        pin.framesForwardKinematics(robot.model, data, q)
        return data.oMf[robot.frame_id(frame)].copy()

    arrival = np.linalg.norm(pose(way[a - 1], "base_link").translation - place.way_point.translation)
    lowest = min(pose(q, "altimeter").translation[2] for q in way[:b:_EVERY]) - place.floor
    landed = pose(way[c - 1], "altimeter").translation[2] - place.floor
    off = max(misalignment(pose(q, "base_link"), place.target) for q in way[b - 1 : c : _EVERY])
    return (
        f"The plan carried out: {arrival:.3f} m from the way point at the end of A (asked: {asked.way_point:g}), altitude "
        f"{lowest:.2f} m and more in A and B ({altitude:g}), misalignment {off:.3f} rad and less from the end of B to that "
        f"of C ({asked.misalignment:g}), altitude {landed:.3f} m at the end of C ({asked.landing_altitude:g})."
    )


def misalignment(X_WB: pin.SE3, target: np.ndarray) -> float:
    """Angle [rad] between the vehicle's x axis and the target (3,) [m] in W, seen from above."""
    forward, to_target = X_WB.rotation[:2, 0], (target - X_WB.translation)[:2]
    cosine = forward @ to_target / (np.linalg.norm(forward) * np.linalg.norm(to_target))
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def tilt_of(q: np.ndarray) -> float:
    """Angle [rad] between the vehicle's z axis and the vertical, at q (n_q,)."""
    R = pin.Quaternion(*q[[6, 3, 4, 5]]).toRotationMatrix()
    return float(np.arccos(np.clip(R[2, 2], -1.0, 1.0)))


def tool_error(robot: Robot, q: np.ndarray, place: Place) -> float:
    """[m] from the target, at q (n_q,)."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return float(np.linalg.norm(data.oMf[robot.frame_id("tool")].translation - place.target))
