"""Strict levels beside weights in receding horizon: ``python benchmarks/nmpc_levels.py [--seeds
N]``.

Goals that exclude each other for a while, on the dynamic plant in a gusty current. Writes
nmpc_levels.csv, one row per run, and the worst of all seeds to nmpc_levels.md.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from horizon.conflict_runs import GAINS, LEVELS, ConflictRuns, conflict_rows
from horizon.receding_conflicts import LEEWAY, MARGIN, SETTLING, SPEED, WAY
from horizon.worst_of_seeds import worst_of_seeds
from recording.processes import hide_compiler
from recording.report import Report, Row, Table, begin, parser_of
from recording.rows import column, rows_where

# Largest errors that are wanted
TOOL = 25.0  # [mm] of the tool below tilt
HELD = 5.0  # [mm] of the vehicle above the tool
BACK = 10.0  # [mm] of the tool after its goal has come back
PROSE = """
{seeds} seeds; the worst of them, but energy and median times are means, counts sums, and times
processor time. *tilt above tool*: the goal goes {way:g} m out and back at {speed:g} m/s, and the
vehicle goes along without tilting; wanted: the tool within {tool:g} mm. *vehicle above tool*: the
same, out of the reach of the arm, while the vehicle stays; wanted: the vehicle within {held:g} mm,
the tool within {back:g} mm from {settling:g} s after the goal's return. The same with an arm that
is stretched at first towards a goal out of reach. *clearance above tool*: a ball comes to where the
tool is to be and leaves again; wanted: a gap of {margin:g} mm, for which plans keep {leeway:g} mm
more at their nodes, and the tool as before. `unfit` are plans that broke constraints, so that the
last one went on. Everywhere thrusters are driven {lead:g} times faster than their lag, and the
vehicle follows its plans with {damping:g} /s.

Weights rank the same terms in one level, those of a level so many times as heavy as those of the
next.

Strict levels keep what is wanted in {kept} of {all} runs, with {unfit} of {solves} plans unfit.
"""


def keeps_wanted(row: Row) -> bool:
    """Whether a run keeps what is wanted."""
    if row["conflict"].startswith("tilt"):
        return bool(row["largest tool error [mm]"] <= TOOL)
    is_about_vehicle = row["conflict"].startswith("vehicle")
    if is_about_vehicle and row["largest way of the vehicle [mm]"] > HELD:
        return False
    is_back = row["largest tool error afterwards [mm]"] <= BACK
    is_clear = row["smallest gap [mm]"] >= 1e3 * MARGIN
    return bool(is_back and is_clear)


def prose(runs: ConflictRuns, table: Sequence[Row]) -> str:
    """Fill in the figures of all runs."""
    by_levels = rows_where(table, "priorities", LEVELS)
    return PROSE.format(
        seeds=len(runs.seeds),
        way=WAY,
        speed=SPEED,
        tool=TOOL,
        held=HELD,
        back=BACK,
        settling=SETTLING,
        margin=1e3 * MARGIN,
        leeway=1e3 * LEEWAY,
        lead=GAINS.lead,
        damping=GAINS.vehicle_damping,
        kept=sum(keeps_wanted(row) for row in by_levels),
        all=len(by_levels),
        unfit=sum(column(by_levels, "unfit")),
        solves=sum(column(by_levels, "solves")),
    )


def main() -> None:
    """Run all conflicts in all ways."""
    parser = parser_of(__doc__)
    parser.add_argument(
        "--seeds", type=int, default=10, metavar="N", help="of gusts, for each conflict"
    )
    arguments, run = begin(parser)
    runs = ConflictRuns(seeds=tuple(range(1, arguments.seeds + 1)))
    if run.quick:
        hide_compiler()
        runs = ConflictRuns(seeds=(1,), weights=(10.0,), only=("tilt above tool",), seconds=0.1)
    table = []
    for row in conflict_rows(runs):
        table.append(row)
        sys.stderr.write(f"{row['conflict']}, {row['priorities']}, seed {row['seed']}\n")
    title = "Strict levels and weights in receding horizon"
    tables = [Table(rows=worst_of_seeds(table, "conflict", "priorities"))]
    run.write(
        Report(
            name="nmpc_levels",
            title=title,
            prose=prose(runs, table),
            tables=tables,
            data={"nmpc_levels": table},
        )
    )


if __name__ == "__main__":
    main()
