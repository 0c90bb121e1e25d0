"""Receding-horizon control against the velocity hierarchy: ``python benchmarks/nmpc.py [--seconds
S]``.

Same goals, same water, same dynamic plant. Writes nmpc.csv, one row per run, nmpc_ticks.csv, what
ticks take while plans are made beside them, and a summary of both to nmpc.md.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from horizon.beside import BESIDE, SELDOM, Blocks, tick_rows
from horizon.following import CASES, CURRENT, DOUBLE, DT, GUSTS, PERIOD, Experiment, rows
from horizon.worst_of_seeds import worst_of_seeds
from recording.processes import hide_compiler
from recording.report import Report, Row, Table, begin, parser_of
from recording.rows import column, rows_where

# What NMPC should keep
LARGEST_ERROR = 20.0  # [mm]
LATE = 1.0  # [%] of the plans
TICKS = 1.2  # highest percentile of ticks with plans beside the loop, to that without plans
PROSE = """
{seeds} runs of {seconds:g} s each, mean current {current:g} m/s, gusts of {gusts:g} m/s (double:
{double:g} m/s) standard deviation; {plans:.0f} plans per second over {steps} steps and {horizon:g}
s; control at {rate:.0f} Hz. A plan takes effect one period after the state it starts from was
measured, or later if it took longer by processor time, or by the clock on the wall where named so.
Errors and thrust are the largest of all runs, but rms errors, energies and times their means,
counts their sums; times are processor time unless named otherwise. Targets: largest error
{largest_error:g} mm, at most {late:g} % late. Strict levels are the tool, then tilt and a range of
postures, then effort; NMPC without them weighs the tool against effort.

NMPC keeps the first in {kept} of {cases} cases, with strict levels in {kept_strictly};
{late_share:.2f} % and {late_strictly:.2f} % of the plans are late.

**Beside the loop.** Ticks at {rate:.0f} Hz in real time with one level, in {rounds} rounds of
blocks of {block:g} s that take turns: with a plan every {seldom:g} s, whose ticks do not count,
with all plans in line, and beside. Times are processor time of the tick's own thread unless named
otherwise; ratios are medians of those of neighbouring blocks. Beside, the highest percentile shown
is {share:.2f} times that without plans; wanted: {most:g} times at most.
"""


def prose(
    experiment: Experiment, blocks: Blocks, shown: Sequence[Row], ticks: Sequence[Row]
) -> str:
    """Fill in the figures of all runs."""
    one_level = rows_where(shown, "controller", "NMPC")
    levels = rows_where(shown, "controller", "NMPC, strict levels")
    (plans_beside,) = rows_where(ticks, "ticks", BESIDE)
    return PROSE.format(
        seeds=len(experiment.seeds),
        seconds=experiment.seconds,
        current=float(np.linalg.norm(CURRENT)),
        gusts=GUSTS,
        double=DOUBLE,
        plans=1 / PERIOD,
        steps=experiment.n_steps,
        horizon=experiment.horizon,
        rate=1 / DT,
        largest_error=LARGEST_ERROR,
        late=LATE,
        kept=_kept(one_level),
        kept_strictly=_kept(levels),
        cases=len(one_level),
        late_share=_late(one_level),
        late_strictly=_late(levels),
        rounds=blocks.rounds,
        block=blocks.seconds,
        seldom=SELDOM,
        share=plans_beside["p99 to that without plans [-]"],
        most=TICKS,
    )


def _kept(shown: Sequence[Row]) -> int:
    return sum(row["largest error [mm]"] <= LARGEST_ERROR for row in shown)


def _late(shown: Sequence[Row]) -> float:
    return 100.0 * sum(column(shown, "late")) / max(1, sum(column(shown, "solves")))


def measured(experiment: Experiment) -> list[Row]:
    """All rows; a line on stderr for each."""
    table = []
    for row in rows(experiment):
        table.append(row)
        sys.stderr.write(f"{row['case']}, {row['controller']}, seed {row['seed']}\n")
    return table


def main() -> None:
    """Run all cases with all controllers."""
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, metavar="S", help="of each run")
    arguments, run = begin(parser)
    if run.quick:
        hide_compiler()
        experiment = Experiment(
            cases=("station",), seeds=(1,), seconds=0.1, horizon=1.0, n_steps=3, gains=(1.0,)
        )
        blocks = Blocks(rounds=1, seconds=0.1, warm=0.1)
    else:
        experiment = Experiment(cases=tuple(CASES), seconds=arguments.seconds)
        blocks = Blocks()
    table = measured(experiment)
    shown = worst_of_seeds(table, "case", "controller")
    ticks = list(tick_rows(experiment, blocks))
    run.write(
        Report(
            name="nmpc",
            title="Receding-horizon control",
            prose=prose(experiment, blocks, shown, ticks),
            tables=[Table(rows=shown), Table(rows=ticks)],
            data={"nmpc": table, "nmpc_ticks": ticks},
        )
    )


if __name__ == "__main__":
    main()
