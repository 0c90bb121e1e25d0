"""Receding-horizon control against the velocity hierarchy with its dynamic control layer: same goals, same water.

python benchmarks/ocp/nmpc.py benchmarks/results [seconds]
"""

from __future__ import annotations

import csv
import os
import platform
import sys
from collections.abc import Callable, Iterable
from importlib.metadata import version
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.control.force.dynamic import DynamicController
from uvms_ocp.control.receding.nmpc import Nmpc
from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import Phase
from uvms_ocp.model.dynamics import robot_dynamics
from uvms_ocp.model.kinematics import Kinematics
from uvms_ocp.model.loading import load_robot
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import Command, Measurement, State
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.terms import At, Effort, Smoothness, TaskTerm
from uvms_ocp.sim.currents import GustyCurrent, UniformCurrent
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.solvers.hierarchy.active_set.solver import LexicographicActiveSet
from uvms_ocp.tasks.attitude import HorizontalAttitude
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.joints import JointLimits, JointTracking
from uvms_ocp.tasks.pose import ToolPose
from uvms_ocp.tasks.reference import PoseReference

CURRENT = np.array([0.3, 0.0, 0.0])  # [m/s]
JOINTS = (0.0, -0.6, 0.0, -1.2, 0.0, -0.6, 0.0)
DT, PERIOD = 1 / 200, 1 / 20  # [s] of control and of planning
SEEDS = (1, 2, 3)
Controller = Callable[[Measurement, float], Command]
Row = dict[str, Any]


def start_of(robot: Robot) -> np.ndarray:
    return robot.configuration(position=(0, 0, -5), rpy=(0, 0, 0.5), joints=JOINTS)


def tool_position(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Of a true state, which may be pressed against a joint's stop."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.frame_id("tool")].translation.copy()


def station(first: pin.SE3) -> PoseReference:
    return lambda t: (first, np.zeros(6))


def circle(first: pin.SE3, *, radius: float = 0.3, speed: float = 0.1) -> PoseReference:
    """Horizontal, at full speed [m/s] after 2 s."""

    def at(t: float) -> tuple[pin.SE3, np.ndarray]:
        way, now = (speed * (t - 1), speed) if t > 2 else (speed * t * t / 4, speed * t / 2)
        s, c = np.sin(way / radius), np.cos(way / radius)
        moved = first.translation + radius * np.array([s, 1 - c, 0.0])
        return pin.SE3(first.rotation, moved), now * np.array([c, s, 0.0, 0.0, 0.0, 0.0])

    return at


def back_and_forth(first: pin.SE3, *, way: float = 0.5, speed: float = 0.1) -> PoseReference:
    """Along y, turning round at once: what only a look ahead can be ready for."""

    def at(t: float) -> tuple[pin.SE3, np.ndarray]:
        place = speed * t % (2 * way)
        forth = place < way
        direction = np.array([0.0, 1.0 if forth else -1.0, 0.0])
        moved = first.translation + np.array([0.0, place if forth else 2 * way - place, 0.0])
        return pin.SE3(first.rotation, moved), np.concatenate([speed * direction, np.zeros(3)])

    return at


CASES: dict[str, tuple[Callable[[pin.SE3], PoseReference], float]] = {
    "station": (station, 0.05),
    "circle 0.3 m, 0.05 m/s": (lambda first: circle(first, speed=0.05), 0.05),
    "circle 0.3 m, 0.1 m/s": (circle, 0.05),
    "back and forth 0.5 m, 0.1 m/s": (back_and_forth, 0.05),
    "circle 0.3 m, 0.1 m/s, double gusts": (circle, 0.1),
}
"""Goal, and standard deviation of the gusts [m/s]."""


def problem(robot: Robot, goal: PoseReference) -> OcpProblem:
    """20 steps over 3 s; the tool is weighed against effort in one level."""
    task = ToolPose(goal=goal)
    tool = (TaskTerm(task=task, at=At.PATH, weight=10.0), TaskTerm(task=task, weight=3.0))
    levels = [OcpLevel(name="follow", terms=(*tool, Effort(), Smoothness(weight=0.3)))]
    start = State(q=start_of(robot), v=np.zeros(robot.n_v))
    return single_phase(robot=robot, start=start, duration=3.0, n_steps=20, levels=levels, current=CURRENT)


def hierarchy(robot: Robot, goal: PoseReference, gain: float) -> DynamicController:
    """Joint limits, tilt, tool, posture; above the dynamic control layer with its observer."""
    tasks = [
        JointLimits(),
        HorizontalAttitude(),
        ToolPose(goal=goal, gain_linear=gain, gain_angular=gain),
        JointTracking(joints=robot.joint_names, goal=np.array(JOINTS)),
    ]
    phase = Phase(name="follow", transitions=(), gates={task.name: 1.0 for task in tasks})
    mission = Mission(hierarchy=Hierarchy(tasks), phases=(phase,))
    kinematic = KinematicController(robot=robot, mission=mission, solver=LexicographicActiveSet(), dt=DT)
    return DynamicController(robot=robot, dynamics=robot_dynamics(robot), kinematic=kinematic)


def controllers(robot: Robot, goal: PoseReference) -> Iterable[tuple[str, Controller]]:
    # Processor time leaves out what other programs take meanwhile, the clock on the wall does not.
    yield "NMPC", Nmpc(problem(robot, goal), dt=DT, period=PERIOD, clock=process_time)
    yield "NMPC, clock on the wall", Nmpc(problem(robot, goal), dt=DT, period=PERIOD)
    for gain in (1.0, 2.0, 4.0):
        yield f"hierarchy, tool gain {gain:g} /s", hierarchy(robot, goal, gain)


def run(robot: Robot, controller: Controller, goal: PoseReference, gusts: float, seed: int, seconds: float) -> Row:
    """Follow the goal; errors [m] of the tool, energy [J], thrust [N], processor time per call [s]."""
    current = GustyCurrent(base=UniformCurrent(CURRENT), sigma=gusts, seed=seed)
    environment = Environment(seafloor=FlatSeafloor(z=-40), current=current)
    plant = DynamicPlant(robot, start_of(robot), dynamics=robot_dynamics(robot), environment=environment)
    errors, times, peak = [], [], 0.0
    for i in range(round(seconds / DT)):
        measurement = Measurement(q=plant.state.q, v=plant.state.v, altimeter_range=30.0)
        begin = process_time()
        command = controller(measurement, i * DT)
        times.append(process_time() - begin)
        plant.step(command, DT)
        tool = tool_position(robot, plant.state.q)
        errors.append(float(np.linalg.norm(tool - goal((i + 1) * DT)[0].translation)))
        peak = max(peak, float(np.abs(plant.telemetry()["thrust"]).max()))
    spent = plant.telemetry()
    return {
        "rms error [mm]": 1e3 * float(np.sqrt(np.mean(np.square(errors)))),
        "largest error [mm]": 1e3 * max(errors),
        "thruster energy [J]": float(np.sum(spent["thruster_energy"])),
        "joint energy [J]": float(spent["joint_energy"]),
        "peak thrust [N]": peak,
        "processor time [ms per s]": 1e3 * sum(times[1:]) / seconds,
        **(deadlines(controller) if isinstance(controller, Nmpc) else {}),
    }


def deadlines(nmpc: Nmpc) -> Row:
    """Of all solves but the first; `late` by the controller's own clock."""
    s = nmpc.statistics
    own, processor = (1e3 * np.array(times) for times in (s.solve_times, s.processor_times))
    return {
        "solves": len(own),
        "late": s.missed,
        "unfit": s.rejected,
        "solve p50 [ms]": float(np.median(processor)),
        "solve p99 [ms]": float(np.percentile(processor, 99)),
        "solve p99, own clock [ms]": float(np.percentile(own, 99)),
    }


def rows(seconds: float) -> Iterable[Row]:
    robot = load_robot("girona_maris7_full")
    first = Kinematics(robot, start_of(robot)).pose("tool")
    for case, (goal_of, gusts) in CASES.items():
        goal = goal_of(first)
        for seed in SEEDS:
            for name, controller in controllers(robot, goal):
                yield {"case": case, "controller": name, "seed": seed} | run(
                    robot, controller, goal, gusts, seed, seconds
                )


def summary(table: list[Row]) -> list[Row]:
    """One row for each case and controller: means over seeds; largest and counts over all of them."""
    kept: dict[tuple[str, str], list[Row]] = {}
    for row in table:
        kept.setdefault((row["case"], row["controller"]), []).append(row)
    result = []
    for (case, name), group in kept.items():
        one: Row = {"case": case, "controller": name}
        for key in group[0]:
            if key in ("case", "controller", "seed"):
                continue
            values = [row[key] for row in group]
            worst = key.startswith(("largest", "peak")) or "p99" in key
            total = key in ("solves", "unfit") or key.startswith("late")
            one[key] = sum(values) if total else max(values) if worst else float(np.mean(values))
        result.append(one)
    return result


def markdown(table: list[Row], seconds: float) -> str:
    shown = summary(table)
    columns = max((list(row) for row in shown), key=len)
    packages = " ".join(f"{name} {version(name)}" for name in ("numpy", "casadi", "pin"))
    text = (
        f"`python benchmarks/ocp/nmpc.py benchmarks/results`; {platform.machine()} {platform.system()} Python "
        f"{platform.python_version()} {packages}, {os.cpu_count()} cores, load average {os.getloadavg()[0]:.1f} at the "
        f"end of the run. {len(SEEDS)} runs of {seconds:g} s each, mean current 0.3 m/s, gusts of 0.05 m/s (double: 0.1 "
        "m/s) standard deviation; 20 plans per second over 20 steps and 3 s; control at 200 Hz. "
        "A plan takes effect one period after the state it starts from was measured, or later if it took longer by "
        "processor time, or by the clock on the wall where named so. Errors and thrust are the largest of all runs, but "
        "rms errors, energies and times their means, counts their sums; times are processor time unless named "
        "otherwise. Targets: largest error 20 mm, at most 1 % late."
    )
    rows_of_text = ["| " + " | ".join(_text(row.get(key, "")) for key in columns) + " |" for row in shown]
    head = ["| " + " | ".join(columns) + " |", "|---" * len(columns) + "|"]
    return "\n".join(["# Receding-horizon control", "", text, "", *head, *rows_of_text, ""])


def _text(value: Any) -> str:
    if not isinstance(value, float):
        return str(value)
    return f"{value:.3g}" if value < 1e3 else f"{value:.0f}"


def main(folder: Path, seconds: float = 20.0) -> None:
    table = []
    for row in rows(seconds):
        table.append(row)
        print({key: _text(value) for key, value in row.items()}, flush=True)
    columns = max((list(row) for row in table), key=len)
    with (folder / "nmpc.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)
    (folder / "nmpc.md").write_text(markdown(table, seconds), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *(float(given) for given in sys.argv[2:3]))
