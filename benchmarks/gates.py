"""Phase changes by external gates, strict and regularised: ``python benchmarks/gates.py [--figure PNG]``.

Runs Case 1 on the kinematic plant with the strict hierarchy and with iCAT, which reads the same gates as weights. Writes
gates.csv and gates.md, one row per solver and phase change; the figure only where a path is given.
"""

from __future__ import annotations

from pathlib import Path

from recording.report import Report, Table, begin, parser_of

from uvms_ocp.control.velocity.kinematic import HierarchySolver
from uvms_ocp.report.transitions import WINDOW, transition_series, transition_table
from uvms_ocp.scenarios.case1 import case1
from uvms_ocp.solvers.hierarchy.active_set.solver import LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.icat import Icat
from uvms_ocp.viz.comparison import figure_transitions

SOLVERS: dict[str, HierarchySolver] = {"lexls": LexicographicActiveSet(), "icat": Icat()}
PROSE = """
Kinematic plant, {rate:.0f} Hz. A change counts from its begin for {window:g} s; *all* is the whole run, whose t is the
time to finish.

- *step*: largest change of any axis of v in one tick, as a share of its acceleration limit times dt.
- *jerk*: largest second difference of v of any axis [m/s^3, rad/s^3], and its root mean square over the ticks.
- *lost*: what any constraint, safety task or prerequisite that is fully on misses of the rate that the acceleration
  limits let it reach [m/s, rad/s]: tracking that lower levels or the regularisation take from the levels above the
  action.
"""
FORMATS = {"run": "", "change": "", "t_s": ".2f", "step": ".3f", "jerk": ".0f", "jerk_rms": ".1f", "lost": ".1e"}


def main() -> None:
    """Run Case 1 once per solver."""
    parser = parser_of(__doc__)
    parser.add_argument("--figure", type=Path, metavar="PNG", help="draw it as well")
    given, run = begin(parser)
    dt = 1 / 50 if run.quick else 1 / 200
    records = {name: case1(solver=solver, plant="kinematic", dt=dt).run() for name, solver in SOLVERS.items()}
    prose = PROSE.format(rate=1 / dt, window=WINDOW)
    table = Table(rows=transition_table(records), columns=FORMATS)
    run.write(Report(name="gates", title="Phase changes of Case 1", prose=prose, tables=[table]))
    if given.figure:
        series = {name: transition_series(record) for name, record in records.items()}
        figure_transitions(series).savefig(given.figure)


if __name__ == "__main__":
    main()
