"""Phase changes by external gates, strict and regularised: ``python benchmarks/gates.py [--figure
PNG]``.

Runs missions on the kinematic plant with the strict hierarchy and with iCAT, which reads the same
gates as weights. Writes gates.csv and gates.md, one row per mission, solver and phase change; the
figure, of Case 1, only where a path is given.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from recording.report import Report, Row, Table, begin, parser_of
from recording.rows import rows_where

from uvms_ocp.control.velocity.kinematic import HierarchySolver
from uvms_ocp.report.comparison import WINDOW, transition_series, transition_table
from uvms_ocp.scenario.cases.case1 import case1, priority_swap
from uvms_ocp.scenario.cases.case2 import case2
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.cascade import LexicographicQp
from uvms_ocp.solvers.hierarchy.icat import Icat
from uvms_ocp.viz.comparison_figures import figure_transitions

MISSIONS: dict[str, Callable[..., Scenario]] = {
    "case1": case1,
    "case2": case2,
    "priority_swap": priority_swap,
}
SOLVERS: dict[str, HierarchySolver] = {
    "active_set": LexicographicActiveSet(),
    "lexqp": LexicographicQp(),
    "icat": Icat(),
}
PROSE = """
Kinematic plant, {rate:.0f} Hz. A change counts from its begin for {window:g} s; *all* is the whole
run, whose t is the time to finish.

- *step*: largest change of any axis of v in one tick, as a share of its acceleration limit times
  dt.
- *jerk*: largest second difference of v of any axis [m/s^3, rad/s^3], and its root mean square over
  the ticks.
- *lost*: what any constraint, safety task or prerequisite that is fully on misses of the rate that
  the acceleration limits let it reach [m/s, rad/s]: tracking that lower levels or the
  regularisation take from the levels above the action.

Largest jerk at the phase changes of a mission:

{jerks}
"""
FORMATS = {
    "run": "",
    "change": "",
    "t_s": ".2f",
    "step": ".3f",
    "jerk": ".0f",
    "jerk_rms": ".1f",
    "lost": ".1e",
}


def main() -> None:
    """Run every mission once per solver."""
    parser = parser_of(__doc__)
    parser.add_argument("--figure", type=Path, metavar="PNG", help="draw it as well")
    arguments, run = begin(parser)
    if run.quick:
        dt = 1 / 50
        missions = ["case1"]
    else:
        dt = 1 / 200
        missions = list(MISSIONS)
    records = {}
    for mission in missions:
        for name, solver in SOLVERS.items():
            scenario = MISSIONS[mission](solver=solver, plant="kinematic", dt=dt)
            records[f"{mission} {name}"] = scenario.run()
    rows = transition_table(records)
    jerks = "\n".join(f"- {mission}: {_jerks(rows, mission)}" for mission in missions)
    prose = PROSE.format(rate=1 / dt, window=WINDOW, jerks=jerks)
    run.write(
        Report(
            name="gates",
            title="Phase changes",
            prose=prose,
            tables=[Table(rows=rows, columns=FORMATS)],
        )
    )
    if arguments.figure:
        series = {name: transition_series(records[f"case1 {name}"]) for name in SOLVERS}
        figure_transitions(series).savefig(arguments.figure)


def _jerks(rows: Sequence[Row], mission: str) -> str:
    """The largest at any change, by solver."""
    texts = []
    for name in SOLVERS:
        rows_of_run = rows_where(rows, "run", f"{mission} {name}")
        jerks = [row["jerk"] for row in rows_of_run if row["change"] != "all"]
        texts.append(f"{name} {max(jerks):.0f}")
    return ", ".join(texts)


if __name__ == "__main__":
    main()
