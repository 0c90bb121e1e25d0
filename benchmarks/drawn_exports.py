"""Drawn controllers in C: ``python benchmarks/drawn_exports.py [--exports N] [--jobs N]
[--work DIR --hours H]``.

Vehicles of none to 8 thrusters and arms of none to 5 joints of all kinds, or on a fixed base, fly
drawn missions by either solver; their controllers are exported, built and replayed. Writes
drawn_exports.csv, one row per export of the study `drawn_exports`, and its sums to
drawn_exports.md. With --work DIR it goes on where it was.
"""

from __future__ import annotations

import shutil

from recording.kept_rows import add_study_options, kept_rows, study_report
from recording.processes import compiled_once
from recording.report import Row, begin, parser_of
from recording.rows import column
from studies.drawn_exports import FUSING, PLAIN, drawn_exports, totals

PROSE = """
{exports} exports, drawn with seeds from {first} to {last}; one row each in `drawn_exports.csv`.
*The same bits*: on every tick all that C tells, velocities, thrusts, torques, quantities, flags,
phases and statuses, is what Python told, to the last bit. *Apart*: some number has another bit on
some tick. *Refused*: the package refuses robot, mission or export in one line. Built with
`{plain}`, every eighth with `{fusing}`, by which compilers fuse multiplications where nobody keeps
them from it.

{same} are the same on all of {ticks} ticks, {apart} are apart, the largest difference is
{largest:.2g}; {refused} are refused, {faults} end otherwise. Seeds of what is apart, and of faults:
{seeds}.
"""
COMPILER_NEEDED = "needs a C compiler: install gcc or clang as cc"


def prose(rows: list[Row]) -> str:
    """Fill in the figures of the study."""
    (total, *_) = totals(rows)
    wrong = [f"{row['seed']} ({row['outcome']})" for row in rows if not row["completed"]]
    return PROSE.format(
        exports=len(rows),
        first=rows[0]["seed"],
        last=rows[-1]["seed"],
        plain=" ".join(PLAIN),
        fusing=" ".join(FUSING),
        same=total["the same bits"],
        ticks=total["ticks"],
        apart=total["apart"],
        largest=max(column(rows, "largest_difference")),
        refused=total["refused"],
        faults=total["fault"],
        seeds=", ".join(wrong) or "none",
    )


def main() -> None:
    """Run the study."""
    parser = parser_of(__doc__)
    parser.add_argument("--exports", type=int, default=300, metavar="N")
    add_study_options(parser)
    arguments, run = begin(parser)
    if shutil.which("cc") is None:
        parser.error(COMPILER_NEEDED)
    if run.quick:
        study = drawn_exports(n=1, seed=2)
        jobs = 1
    else:
        study = drawn_exports(n=arguments.exports)
        jobs = arguments.jobs
    with compiled_once() as folder:
        rows = kept_rows(study, arguments.work or folder / "work", jobs, arguments.hours)
    run.write(study_report(study, "Drawn controllers in C", rows, prose(rows)))


if __name__ == "__main__":
    main()
