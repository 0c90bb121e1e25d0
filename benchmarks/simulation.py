"""Speed of simulation: ``python benchmarks/simulation.py [--runs N]``.

Runs missions as a user runs them, in turn with the same tick by tick in Python, and some once more
with a clock between the kernels of a tick. Writes simulation.csv, one row per mission, and
simulation.md, also with the kernels.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from statistics import median
from time import process_time
from typing import Any
from unittest.mock import patch

from recording.report import Report, Row, Table, begin, parser_of
from recording.rows import column

from uvms_ocp.codegen.kernel_expressions import PREFIX
from uvms_ocp.codegen.sequence import Elapsed
from uvms_ocp.record.record import Record
from uvms_ocp.report.summary import summarize
from uvms_ocp.scenario.cases import SCENARIOS
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.compiled_loop import CompiledLoop

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
aside; *in_python*: the same where somebody looks at every tick, so that Python calls the parts one
by one, each run after one of the others. *prepare_s*: time of the processor before and after the
loop, with CasADi's expressions, what has been compiled is loaded. *tick*: levels, solve, viability
and mission; *controller*: all from measurement to thrust and torque.

The other tables: mean time of each kernel for a tick, with a clock between them, and of the whole
loop, with events, swings and rows, for {profiled}, in turn.
"""
COLUMNS = {
    "mission": "",
    "simulated_s": ".1f",
    "loop_s": ".2f",
    "real_time": ".1f",
    "in_python": ".1f",
    "prepare_s": ".2f",
    "tick_p50_us": ".1f",
    "tick_p99_us": ".1f",
    "controller_p50_us": ".1f",
    "controller_p99_us": ".1f",
}


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
    slow = build().run(observer=lambda t, state, command: None).run_meta.wall_s
    tick_us = report["tick_us"]
    controller_us = report["controller_us"]
    return {
        "simulated_s": report["simulated_s"],
        "loop_s": loop,
        "real_time": report["simulated_s"] / loop,
        "in_python": report["simulated_s"] / slow,
        "prepare_s": spent - loop,
        "tick_p50_us": tick_us["p50"],
        "tick_p99_us": tick_us["p99"],
        "controller_p50_us": controller_us["p50"],
        "controller_p99_us": controller_us["p99"],
    }


def profile(build: Callable[[], Scenario]) -> list[Row]:
    """Mean time of each kernel of a tick [us], and of the whole loop for a tick."""
    names: list[str] = []

    def timed(loop: CompiledLoop, *arguments: Any) -> dict[str, Any]:
        names[:] = [kernel.__name__.removeprefix(PREFIX) for kernel, *_ in loop.steps or ()]
        clocks = {f"step_{k}": Elapsed(k, k) for k in range(len(names))}
        return {**sources(loop, *arguments), **clocks}

    sources = CompiledLoop._sources
    with patch.object(CompiledLoop, "_sources", timed):
        record = build().run()
    rows: list[Row] = []
    for k, name in enumerate(names):
        rows.append({"kernel": name, "us": 1e6 * float(record[f"step_{k}"].mean())})
    total = sum(column(rows, "us"))
    whole = 1e6 * record.run_meta.wall_s / len(record)
    return [
        *rows,
        {"kernel": "sum of the kernels", "us": total},
        {"kernel": "whole tick", "us": whole},
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
    for name in PROFILED:
        tables.append(Table(rows=profile(builders[name]), columns={"kernel": "", "us": ".1f"}))
    run.write(Report(name="simulation", title="Speed of simulation", prose=prose, tables=tables))


if __name__ == "__main__":
    main()
