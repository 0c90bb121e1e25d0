"""The estimator on the plant of a mission, whose motion is not that of the process model; and what
a tick of it takes.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import thread_time

import numpy as np
import pinocchio as pin
from recording.rows import column, rows_where

from estimation.consistency import DELAYS, SPECS, late
from uvms_ocp.estimation.estimator import Estimator
from uvms_ocp.report.metrics import estimate_table
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Command, SensorSpecs, State
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.sim.sensors import SensorSuite
from uvms_ocp.types import Array

TIMED = {"default": SensorSpecs(), "every channel": SPECS, "all late": late(SPECS, DELAYS)}
_DT = 1 / 200  # [s]


def mission_table(seeds: int, *, plant: str, duration: float) -> list[dict[str, object]]:
    """One row per seed and part of Case 1 with noise: errors, spreads and the ratio of their
    squares; true tool error.
    """
    rows: list[dict[str, object]] = []
    for seed in range(seeds):
        record = case1(noise=True, plant=plant, seed=seed, duration=duration).run()
        tool = record.run_meta.true_quantity("T.position_error")
        run = {"seed": seed, "completed": record.run_meta.completed, "tool_error_m": tool}
        rows += [{**run, **row} for row in estimate_table(record)]
    return rows


def by_part(rows: list[dict[str, object]]) -> list[dict[str, object]]:
    """One row per part: root mean square errors and spreads over all seeds, and the ratio of their
    squares.
    """
    table: list[dict[str, object]] = []
    for part in dict.fromkeys(column(rows, "of")):
        rows_of_part = rows_where(rows, "of", part)
        rms = _root_mean_square(column(rows_of_part, "rms"))
        spread = _root_mean_square(column(rows_of_part, "spread"))
        table.append({"of": part, "rms": rms, "spread": spread, "ratio": (rms / spread) ** 2})
    return table


def _root_mean_square(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean([float(value) ** 2 for value in values])))


def time_table(robot: Robot, *, ticks: int) -> list[dict[str, object]]:
    """One row per set of sensors [us of the processor]: a tick of the estimator and of its core,
    median and 99th percentile.
    """
    rows: list[dict[str, object]] = []
    for name, specs in TIMED.items():
        whole, core = _tick_times(robot, specs, ticks)
        rows.append(
            {
                "sensors": name,
                "tick_p50_us": float(np.percentile(whole, 50)),
                "tick_p99_us": float(np.percentile(whole, 99)),
                "core_p50_us": float(np.percentile(core, 50)),
                "core_p99_us": float(np.percentile(core, 99)),
            }
        )
    return rows


def _tick_times(robot: Robot, specs: SensorSpecs, ticks: int) -> tuple[Array, Array]:
    estimator = Estimator(robot, specs)
    suite = SensorSuite(robot, FlatSeafloor(z=-40.0), specs, seed=1)
    advance = estimator.advance
    core = []
    whole = []

    def timed_core() -> None:
        begin = thread_time()
        advance()
        core.append(thread_time() - begin)

    estimator.advance = timed_core
    q = robot.configuration(position=(1.0, 2.0, -36.0))
    size = np.where(np.arange(robot.n_v) < 6, 0.2, 0.4)
    rate = np.linspace(0.5, 1.2, robot.n_v)
    for k in range(ticks):
        t = k * _DT
        v = size * np.sin(rate * t)
        a = size * rate * np.cos(rate * t)
        readings = suite.read(State(q=q, v=v, a=a), t)
        command = Command(v=v)
        begin = thread_time()
        estimator(readings, t, command)
        whole.append(thread_time() - begin)
        q = pin.integrate(robot.model, q, v * _DT)
    return 1e6 * np.array(whole[ticks // 10 :]), 1e6 * np.array(core[ticks // 10 :])
