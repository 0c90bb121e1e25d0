"""Speed of simulation: ``python benchmarks/simulation.py [--runs N]``.

Runs missions as a user runs them, and one of them once more with a clock around each part of a tick. Writes simulation.csv,
one row per mission, and simulation.md, also with the parts.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from statistics import median
from time import process_time, thread_time_ns
from typing import Any
from unittest.mock import patch

from recording.report import Report, Row, Table, begin, parser_of

from uvms_ocp.control.force.dynamic import DynamicController
from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.estimation.health.guarded_estimator import GuardedEstimator
from uvms_ocp.record.record import Record, Recorder
from uvms_ocp.report.summary import summarize
from uvms_ocp.scenario.cases import SCENARIOS
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.plant import DynamicPlant
from uvms_ocp.sim.sensors import SensorSuite

MISSIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "case1": ("case1", {}),
    "case1, kinematic": ("case1", {"plant": "kinematic"}),
    "case1, noise": ("case1", {"noise": True}),
    "obstacle_field": ("obstacle_field", {}),
}
PARTS: dict[str, tuple[type, str]] = {
    "sensors": (SensorSuite, "read"),
    "estimate and health": (GuardedEstimator, "__call__"),
    "controller": (DynamicController, "__call__"),
    "of it, what is known": (KinematicController, "observe"),
    "of it, hierarchy, viability, mission": (KinematicController, "command"),
    "plant": (DynamicPlant, "step"),
    "record": (Recorder, "append"),
}
PROSE = """
One process, control at {rate:.0f} Hz, the plant in its usual steps; the median of {runs} runs of each, after one that
compiled. *real_time*: simulated time for one second of the loop, preparation aside. *prepare_s*: time of the processor before
and after the loop, with CasADi's expressions, what has been compiled is loaded. *tick*: levels, solve, viability and mission,
from Python; *controller*: all from measurement to thrust and torque.

The second table is of {profiled}: mean time of the processor per tick in each part, with the clocks around the parts at work.
"""
COLUMNS = {
    "mission": "",
    "simulated_s": ".1f",
    "loop_s": ".2f",
    "real_time": ".1f",
    "prepare_s": ".2f",
    "tick_p50_us": ".1f",
    "tick_p99_us": ".1f",
    "controller_p50_us": ".1f",
    "controller_p99_us": ".1f",
}


def measured(name: str, build: Callable[[], Scenario], runs: int) -> Row:
    """One row: medians of so many runs."""
    rows = [_run(build) for _ in range(runs)]
    return {"mission": name, **{key: median(row[key] for row in rows) for key in rows[0]}}


def _run(build: Callable[[], Scenario]) -> dict[str, float]:
    begin = process_time()
    record = build().run()
    spent, report = process_time() - begin, summarize(record)
    loop = record.run_meta.wall_s
    times = {"tick": report["tick_us"], "controller": report["controller_us"]}
    return {
        "simulated_s": report["simulated_s"],
        "loop_s": loop,
        "real_time": report["simulated_s"] / loop,
        "prepare_s": spent - loop,
        **{f"{what}_{share}_us": values[share] for what, values in times.items() for share in ("p50", "p99")},
    }


def profile(scenario: Scenario) -> list[Row]:
    """Mean time of each part of a tick [us]."""
    with _clocks() as spent:
        record = scenario.run()
    ticks = len(record)
    total = 1e6 * record.run_meta.wall_s / ticks
    rows = [{"part": name, "us": 1e-3 * spent[name] / ticks} for name in PARTS]
    return [*rows, {"part": "whole tick", "us": total}]


@contextmanager
def _clocks() -> Iterator[dict[str, int]]:
    """Inside, the time [ns] that every part of the loop takes is added up."""
    spent: dict[str, int] = defaultdict(int)
    with ExitStack() as stack:
        for name, (owner, method) in PARTS.items():
            stack.enter_context(patch.object(owner, method, _clocked(getattr(owner, method), name, spent)))
        yield spent


def _clocked(method: Callable[..., Any], name: str, spent: dict[str, int]) -> Callable[..., Any]:
    def call(*args: Any, **kwargs: Any) -> Any:
        begin = thread_time_ns()
        result = method(*args, **kwargs)
        spent[name] += thread_time_ns() - begin
        return result

    return call


def main() -> None:
    """Measure all, and write."""
    parser = parser_of(__doc__)
    parser.add_argument("--runs", type=int, default=3, metavar="N", help="of each mission")
    given, run = begin(parser)
    short = {"duration": 0.5} if run.quick else {}
    builders = {
        name: (lambda scenario=scenario, options=options: SCENARIOS[scenario](**options, **short))
        for name, (scenario, options) in MISSIONS.items()
    }
    for build in builders.values():
        warm: Record = build().run()
    runs = 1 if run.quick else given.runs
    rows = [measured(name, build, runs) for name, build in builders.items()]
    first = next(iter(builders))
    prose = PROSE.format(rate=1.0 / warm.run_meta.dt, runs=runs, profiled=first)
    tables = [Table(rows=rows, columns=COLUMNS), Table(rows=profile(builders[first]()), columns={"part": "", "us": ".1f"})]
    run.write(Report(name="simulation", title="Speed of simulation", prose=prose, tables=tables))


if __name__ == "__main__":
    main()
