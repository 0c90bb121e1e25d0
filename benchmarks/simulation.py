"""Speed of simulation: ``python benchmarks/simulation.py [--runs N]``.

Runs missions as a user runs them, in turn with the same tick by tick in Python, and some once more
with a clock between the kernels of a tick. Writes simulation.csv, one row per mission, and
simulation.md, also with the kernels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from statistics import median
from time import process_time
from typing import Any
from unittest.mock import patch

from recording.report import Report, Row, Table, begin, parser_of
from recording.rows import column

from uvms_ocp.checks import replace_unchecked
from uvms_ocp.codegen.sequence import Elapsed
from uvms_ocp.record.record import Record
from uvms_ocp.report.summary import summarize
from uvms_ocp.robot.dynamics import cached_dynamics
from uvms_ocp.robot.signals import Command, Readings, SensorSpecs, State, StateEstimate
from uvms_ocp.scenario.cases import SCENARIOS
from uvms_ocp.scenario.part_factories import our_controller, our_estimator
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim import DynamicPlant, SensorSuite
from uvms_ocp.sim.tick import Tick

MISSIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "case1": ("case1", {}),
    "case1, kinematic": ("case1", {"plant": "kinematic"}),
    "case1, noise": ("case1", {"noise": True}),
    "obstacle_field": ("obstacle_field", {}),
}
PROFILED = ("case1", "case1, noise")
PROSE = """
One process, control at {rate:.0f} Hz, the plant in its usual steps; the median of {runs} runs of
each, after one that compiled. *real_time*: simulated time for one second of the loop, preparation
aside; *looked_at*: the same where somebody looks on at every tick, each run after one of the
others. *prepare_s*: time of the processor before and after the
loop, with CasADi's expressions, what has been compiled is loaded. *tick*: levels, solve, viability
and mission; *controller*: all from measurement to thrust and torque.

The second table: real-time factors of case1 with noise where one part is a user's own in Python,
here one that passes on what the toolkit's does, runs of each in turn.

The other tables: mean time of each step for a tick, with a clock between them, and of the whole
loop, with events, swings and rows, for {profiled}, in turn.
"""
COLUMNS = {
    "mission": "",
    "simulated_s": ".1f",
    "loop_s": ".2f",
    "real_time": ".1f",
    "looked_at": ".1f",
    "prepare_s": ".2f",
    "tick_p50_us": ".1f",
    "tick_p99_us": ".1f",
    "controller_p50_us": ".1f",
    "controller_p99_us": ".1f",
}


class PassedOnPlant:
    """The toolkit's plant, asked as a user's own."""

    takes_forces = True

    def __init__(self, scenario: Scenario) -> None:
        robot = scenario.robot
        self._plant = DynamicPlant(
            robot,
            scenario.start,
            dynamics=cached_dynamics(robot),
            environment=scenario.environment,
        )
        self.state = self._plant.state

    def step(self, command: Command, dt: float) -> None:
        """Advance by dt [s]."""
        self._plant.step(command, dt)
        self.state = self._plant.state

    def telemetry(self) -> dict[str, Any]:
        """Return that of the plant."""
        return self._plant.telemetry()


class PassedOnSensors:
    """Maker of the toolkit's sensors, asked as a user's own."""

    specs = SensorSpecs()

    def __call__(self, scenario: Scenario) -> Callable[[State, float], Readings]:
        """Make them for one run."""
        suite = SensorSuite(
            scenario.robot, scenario.environment.seafloor, self.specs, scenario.seed
        )
        return lambda state, t: suite.read(state, t)


def passed_on_estimator(scenario: Scenario) -> Callable[..., StateEstimate]:
    """Make the toolkit's filter, asked as a user's own."""
    estimator = our_estimator(scenario)
    return lambda readings, t, command: estimator(readings, t, command)


def passed_on_controller(scenario: Scenario) -> Callable[[StateEstimate, float], Command]:
    """Make the toolkit's controller, asked as a user's own."""
    controller = our_controller(scenario)
    return lambda estimate, t: replace_unchecked(controller(estimate, t), telemetry={})


OWN_PARTS: dict[str, dict[str, Any]] = {
    "none": {},
    "plant": {"plant": PassedOnPlant},
    "sensors": {"sensors": PassedOnSensors()},
    "estimator": {"estimator": passed_on_estimator},
    "controller": {"controller": passed_on_controller},
}
"""Parts of a scenario by the one that is asked."""


def measured(name: str, build: Callable[[], Scenario], runs: int) -> Row:
    """One row: medians of so many runs."""
    rows = [_run(build) for _ in range(runs)]
    medians = {figure: median(column(rows, figure)) for figure in rows[0]}
    return {"mission": name, **medians}


def _run(build: Callable[[], Scenario]) -> dict[str, float]:
    begin = process_time()
    record = build().run()
    spent = process_time() - begin
    report = summarize(record)
    loop = record.run_meta.wall_s
    looked_at = build().run(observer=lambda t, state, command: None).run_meta.wall_s
    tick_us = report["tick_us"]
    controller_us = report["controller_us"]
    return {
        "simulated_s": report["simulated_s"],
        "loop_s": loop,
        "real_time": report["simulated_s"] / loop,
        "looked_at": report["simulated_s"] / looked_at,
        "prepare_s": spent - loop,
        "tick_p50_us": tick_us["p50"],
        "tick_p99_us": tick_us["p99"],
        "controller_p50_us": controller_us["p50"],
        "controller_p99_us": controller_us["p99"],
    }


def asked(build: Callable[[], Scenario], runs: int) -> list[Row]:
    """One row for each part that is asked: the medians of so many runs."""
    speeds: dict[str, list[float]] = {name: [] for name in OWN_PARTS}
    for _ in range(runs):
        for name, parts in OWN_PARTS.items():
            record = replace(build(), **parts).run()
            speeds[name].append(float(record["t"][-1]) / record.run_meta.wall_s)
    return [{"asked": name, "real_time": median(values)} for name, values in speeds.items()]


def profile(build: Callable[[], Scenario]) -> list[Row]:
    """Mean time of each step of a tick [us], and of the whole loop for a tick."""
    names: list[str] = []

    def timed(tick: Tick) -> dict[str, Any]:
        names[:] = [step.name for step in tick.steps()]
        clocks = {f"step_{name}": Elapsed(name, name) for name in names}
        return {**sources(tick), **clocks}

    sources = Tick.sources
    with patch.object(Tick, "sources", timed):
        record = build().run()
    rows: list[Row] = []
    for name in names:
        rows.append({"step": name, "us": 1e6 * float(record[f"step_{name}"].mean())})
    total = sum(column(rows, "us"))
    whole = 1e6 * record.run_meta.wall_s / len(record)
    return [
        *rows,
        {"step": "sum of the steps", "us": total},
        {"step": "whole tick", "us": whole},
    ]


def main() -> None:
    """Measure all, and write."""
    parser = parser_of(__doc__)
    parser.add_argument("--runs", type=int, default=3, metavar="N", help="of each mission")
    arguments, run = begin(parser)
    short = {"duration": 0.5} if run.quick else {}
    builders = {}
    for name, (scenario, options) in MISSIONS.items():
        builders[name] = partial(SCENARIOS[scenario], **options, **short)
    for build in builders.values():
        warm: Record = build().run()
    runs = 1 if run.quick else arguments.runs
    rows = [measured(name, build, runs) for name, build in builders.items()]
    prose = PROSE.format(rate=1.0 / warm.run_meta.dt, runs=runs, profiled=" and ".join(PROFILED))
    tables = [Table(rows=rows, columns=COLUMNS)]
    rows_of_asked = asked(builders["case1, noise"], runs)
    tables.append(Table(rows=rows_of_asked, columns={"asked": "", "real_time": ".1f"}))
    for name in PROFILED:
        tables.append(Table(rows=profile(builders[name]), columns={"step": "", "us": ".1f"}))
    run.write(Report(name="simulation", title="Speed of simulation", prose=prose, tables=tables))


if __name__ == "__main__":
    main()
