"""Drawn robot files: ``python benchmarks/drawn_files.py [--files N] [--exports N] [--jobs N]
[--work DIR --hours H]``.

Sound robots, of each of which two things are taken away, renamed, doubled or emptied, go from the
file through all commands: new-robot, check-robot, new-mission, check, a kinematic and a dynamic
run, save, load, show, plan curve and, the first of them, export. Writes drawn_files.csv, one row
per file of the study `drawn_files`, and its sums to drawn_files.md. With --work DIR it goes on
where it was.
"""

from __future__ import annotations

from collections import Counter

from recording.kept_rows import add_study_options, kept_rows, study_report
from recording.processes import compiled_once, hide_compiler
from recording.report import Row, begin, parser_of
from recording.rows import column, count_where, rows_where
from studies.drawn_files import REASONS, drawn_files, reason_of

PROSE = """
{files} files, drawn with seeds from {first} to {last}; one row each in `drawn_files.csv`. A file is
through, or refused in one line by the first step that refuses it; anything else that is raised,
mass that is lost, a tool that is none, or a record that is another one once saved and loaded, is a
fault: {faults} of {files}. Runs last {seconds:g} s each, at {rate:.0f} Hz, and are made of what
pre-flight refuses, too; without a compiler, but for the first {exports}, which go through `export`
as well.

Reasons, and how many files were refused for each: {reasons}. For none of these: {others}.
"""


def prose(rows: list[Row]) -> str:
    """Fill in the figures of the study."""
    refusals = rows_where(rows, "outcome", "refused")
    refused = Counter(reason_of(text) for text in column(refusals, "text"))
    reasons = [f"{reason} {refused[reason]}" for reason in REASONS if refused[reason]]
    return PROSE.format(
        first=rows[0]["seed"],
        last=rows[-1]["seed"],
        files=len(rows),
        faults=count_where(rows, "outcome", "fault"),
        seconds=rows[0]["duration_s"],
        rate=1 / rows[0]["dt"],
        exports=sum(column(rows, "exports")),
        reasons=", ".join(reasons) or "none",
        others=refused[""],
    )


def main() -> None:
    """Run the study."""
    parser = parser_of(__doc__)
    parser.add_argument("--files", type=int, default=500, metavar="N")
    parser.add_argument(
        "--exports",
        type=int,
        default=20,
        metavar="N",
        help="of them, through export, with a compiler",
    )
    add_study_options(parser)
    arguments, run = begin(parser)
    if run.quick:
        exports = 0
        files = 1
        jobs = 1
    else:
        exports = arguments.exports
        files = arguments.files
        jobs = arguments.jobs
    rows: list[Row] = []
    with compiled_once() as folder:
        work = arguments.work or folder
        if exports:
            exported = drawn_files(n=exports, exports=True)
            rows += kept_rows(exported, work / "exports", jobs, arguments.hours)
        hide_compiler()
        not_exported = drawn_files(n=files - exports, seed=exports)
        rows += kept_rows(not_exported, work / "files", jobs, arguments.hours)
    run.write(study_report(not_exported, "Drawn robot files", rows, prose(rows)))


if __name__ == "__main__":
    main()
