"""What a tick takes while plans are made beside it, in real time."""

from __future__ import annotations

from collections.abc import Iterator
from time import perf_counter, sleep, thread_time

import numpy as np
from recording.report import Row

from horizon.following import CURRENT, DT, GUSTS, PERIOD, Experiment, problem, start_of
from horizon.receding_conflicts import moving_goal
from uvms_ocp.control.receding.nmpc import Nmpc
from uvms_ocp.control.receding.workers import Beside
from uvms_ocp.model.dynamics import robot_dynamics
from uvms_ocp.model.loading import load_robot
from uvms_ocp.model.state import Measurement
from uvms_ocp.sim.currents import GustyCurrent, UniformCurrent
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.seafloor import FlatSeafloor

WARM = 2.0
"""[s] at the beginning of a run that are not counted."""


def tick_rows(experiment: Experiment) -> Iterator[Row]:
    """Ticks with plans made beside them, and without: the controller is closed after the first plans."""
    robot = load_robot("girona_maris7_full")
    for name, closed in (("plans beside", False), ("no plans", True)):
        with Nmpc(problem(robot, moving_goal(robot), experiment), dt=DT, period=PERIOD, worker=Beside()) as nmpc:
            times = _ticks(nmpc, experiment.seconds, closed)
            statistics = nmpc.statistics
        wall, own = (1e3 * np.array(column) for column in zip(*times, strict=True))
        yield {
            "ticks": name,
            "p50 [ms]": float(np.median(own)),
            "p99 [ms]": float(np.percentile(own, 99)),
            "p99, clock on the wall [ms]": float(np.percentile(wall, 99)),
            "plans": len(statistics.solve_times),
            "late": statistics.missed,
            "unfit": statistics.rejected,
        }


def _ticks(nmpc: Nmpc, seconds: float, closed: bool) -> list[tuple[float, float]]:
    """[s] by the clock on the wall and of the processor, of every tick after the first of them."""
    robot = load_robot("girona_maris7_full")
    water = GustyCurrent(base=UniformCurrent(CURRENT), sigma=GUSTS, seed=1)
    environment = Environment(seafloor=FlatSeafloor(z=-40), current=water)
    plant = DynamicPlant(robot, start_of(robot), dynamics=robot_dynamics(robot), environment=environment)
    times, begin = [], perf_counter()
    for i in range(round((WARM + seconds) / DT)):
        # Sleeping leaves the processor to the other process, as a robot's loop would.
        sleep(max(0.0, begin + i * DT - perf_counter()))
        if closed and i * DT >= WARM:
            nmpc.close()
        measurement = Measurement(q=plant.state.q, v=plant.state.v, altimeter_range=30.0)
        wall, own = perf_counter(), thread_time()
        command = nmpc(measurement, i * DT)
        times.append((perf_counter() - wall, thread_time() - own))
        plant.step(command, DT)
    return times[round(WARM / DT) :]
