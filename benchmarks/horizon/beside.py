"""What a tick takes while plans are made beside it, within it, and not at all: in real time, in
blocks that take turns.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from time import perf_counter, sleep, thread_time
from typing import Any

import numpy as np
from recording.report import Row

from horizon.following import (
    CURRENT,
    DT,
    GUSTS,
    PERIOD,
    Experiment,
    problem,
    start_of,
    tool_position,
)
from horizon.receding_conflicts import moving_goal
from uvms_ocp.control.nmpc import Nmpc
from uvms_ocp.control.solve_workers import ProcessWorker, SynchronousWorker
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.signals import StateEstimate
from uvms_ocp.sim.currents import GustyCurrent, UniformCurrent
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.seafloor import FlatSeafloor

SELDOM = 2.5
"""[s] between two plans where none is to be counted: less than a horizon, so that there is always
one to follow.
"""
NONE = "no plans"
LINE = "plans in line"
BESIDE = "plans beside"
_WORKERS: dict[str, tuple[float, SynchronousWorker | ProcessWorker]] = {
    NONE: (SELDOM, SynchronousWorker()),
    LINE: (PERIOD, SynchronousWorker()),
    BESIDE: (PERIOD, ProcessWorker()),
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Blocks:
    """How long is measured."""

    rounds: int = 10
    seconds: float = 3.0
    """[s] of a block."""
    warm: float = 2.0
    """[s] of each way that are not counted."""


@dataclass(kw_only=True, slots=True)
class _Way:
    """One controller with a plant of its own, and the times of its ticks."""

    nmpc: Nmpc
    plant: DynamicPlant
    goal: Any
    ticks: int = 0
    blocks: list[np.ndarray] = field(default_factory=list)
    """(n, 2) [ms] processor time of the tick's own thread and time by the clock on the wall, of
    each block.
    """
    errors: list[float] = field(default_factory=list)
    """[mm] of the tool."""

    def run(self, seconds: float, *, planning: bool) -> None:
        """One block; ticks that plan count if `planning`."""
        block = []
        begin = perf_counter()
        for i in range(round(seconds / DT)):
            # Sleeping leaves the processor to the other process, as a robot's loop would.
            sleep(max(0.0, begin + i * DT - perf_counter()))
            solves = len(self.nmpc.statistics.solve_times)
            times = self._tick()
            if planning or len(self.nmpc.statistics.solve_times) == solves:
                block.append(times)
        self.blocks.append(1e3 * np.array(block))

    def _tick(self) -> tuple[float, float]:
        state = self.plant.state
        t = self.ticks * DT
        estimate = StateEstimate(q=state.q, v=state.v, altimeter_range=30.0)
        wall_begin = perf_counter()
        thread_begin = thread_time()
        command = self.nmpc(estimate, t)
        thread_seconds = thread_time() - thread_begin
        wall_seconds = perf_counter() - wall_begin
        self.plant.step(command, DT)
        self.ticks += 1
        tool = tool_position(self.nmpc._robot, self.plant.state.q)
        goal, _ = self.goal(self.ticks * DT)
        self.errors.append(1e3 * float(np.linalg.norm(tool - goal.translation)))
        return thread_seconds, wall_seconds


def tick_rows(experiment: Experiment, blocks: Blocks) -> Iterator[Row]:
    """One row per way to plan."""
    ways = {name: _way(experiment, period, worker) for name, (period, worker) in _WORKERS.items()}
    for way in ways.values():
        way.run(blocks.warm, planning=True)
        way.blocks.clear()
        way.errors.clear()
    for _ in range(blocks.rounds):
        for name, way in ways.items():
            way.run(blocks.seconds, planning=name != NONE)
    for name, way in ways.items():
        way.nmpc.close()
        yield {"ticks": name, **_figures(way, ways[NONE])}


def _figures(way: _Way, without: _Way) -> Row:
    """Ratios are medians of those of blocks that were next to each other."""
    all_ticks = np.concatenate(way.blocks)
    statistics = way.nmpc.statistics
    peaks = np.array([np.percentile(block, 99, axis=0) for block in way.blocks])
    peaks_without = np.array([np.percentile(block, 99, axis=0) for block in without.blocks])
    thread_ratio, wall_ratio = np.median(peaks / peaks_without, axis=0).tolist()
    return {
        "p50 [ms]": float(np.median(all_ticks[:, 0])),
        "p99 [ms]": float(np.percentile(all_ticks[:, 0], 99)),
        "p99 to that without plans [-]": thread_ratio,
        "p99, clock on the wall [ms]": float(np.percentile(all_ticks[:, 1], 99)),
        "to that without plans [-]": wall_ratio,
        "plans": len(statistics.solve_times),
        "late": statistics.missed,
        "unfit": statistics.rejected,
        "rms error [mm]": float(np.sqrt(np.mean(np.square(way.errors)))),
    }


def _way(experiment: Experiment, period: float, worker: SynchronousWorker | ProcessWorker) -> _Way:
    robot = load_robot("girona_maris7_full")
    water = GustyCurrent(base=UniformCurrent(CURRENT), sigma=GUSTS, seed=1)
    environment = Environment(seafloor=FlatSeafloor(z=-40), current=water)
    goal = moving_goal(robot, begin=4.0)
    return _Way(
        nmpc=Nmpc(problem(robot, goal, experiment), dt=DT, period=period, worker=worker),
        plant=DynamicPlant(
            robot, start_of(robot), dynamics=robot_dynamics(robot), environment=environment
        ),
        goal=goal,
    )
