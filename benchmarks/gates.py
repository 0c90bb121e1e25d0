"""Phase changes by external gates, strict and regularised: ``python benchmarks/gates.py [--figure PNG]``.

Runs Case 1 on the kinematic plant with the strict hierarchy and with iCAT, which reads the same gates as weights. Writes
``results/gates.csv``, one row per solver and phase change, and the same as a report, ``gates.md``; the figure only where
a path is given.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import Any

from uvms_ocp.report.transitions import transition_series, transition_table
from uvms_ocp.scenarios.case1 import case1
from uvms_ocp.solvers.hierarchy.active_set.solver import LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.icat import Icat
from uvms_ocp.viz.comparison import figure_transitions

REPORT = """# Phase changes of Case 1

`python benchmarks/gates.py`, kinematic plant, 200 Hz. A change counts from its begin for one second; *all* is the whole run,
whose t is the time to finish.

- *step*: largest change of any axis of v in one tick, as a share of its acceleration limit times dt.
- *jerk*: largest second difference of v of any axis [m/s3, rad/s3], and its root mean square over the ticks.
- *lost*: what any constraint, safety task or prerequisite that is fully on misses of the rate that the acceleration limits
  let it reach [m/s, rad/s]: tracking that lower levels or the regularisation take from the levels above the action.

| solver | change | t [s] | step | jerk | rms jerk | lost |
|---|---|---|---|---|---|---|
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--figure", type=Path, help="PNG to draw")
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "results" / "gates.csv")
    arguments = parser.parse_args()
    solvers = {"lexls": LexicographicActiveSet(), "icat": Icat()}
    records = {name: case1(solver=solver, plant="kinematic").run() for name, solver in solvers.items()}
    write(transition_table(records), arguments.output)
    if arguments.figure:
        figure_transitions({name: transition_series(record) for name, record in records.items()}).savefig(
            arguments.figure
        )


def write(rows: list[dict[str, Any]], path: Path) -> None:
    """CSV, and the report beside it."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    line = "| {run} | {change} | {t_s:.2f} | {step:.3f} | {jerk:.0f} | {jerk_rms:.1f} | {lost:.1e} |\n"
    path.with_suffix(".md").write_text(REPORT + "".join(line.format(**row) for row in rows))


if __name__ == "__main__":
    main()
