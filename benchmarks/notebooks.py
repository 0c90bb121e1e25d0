"""Every notebook from its first cell to its last, in full: ``python benchmarks/notebooks.py [NAME
...]``.

Writes notebooks.csv, one row per notebook, and notebooks.md. The tests run them with ``FAST =
True``, as they are stored.
"""

from __future__ import annotations

import re
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from recording.report import Report, Row, Table, begin, parser_of
from recording.rows import column, count_where

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
QUICK = ("10_stepping_a_robot",)
_LONGEST = 4 * 3600  # [s] of one cell
_FAST = re.compile(r"^FAST = True$", re.MULTILINE)
PROSE = """
{run} of {number} notebooks run to their end{mode}, each in an empty folder; {total:.0f} s together,
by the clock on the wall.
"""


def executed(path: Path, *, fast: bool) -> Row:
    """One notebook: what it took, and what ended it if anything did."""
    notebook = nbformat.read(path, as_version=4)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    changed = 0
    if not fast:
        for cell in cells:
            cell.source, times = _FAST.subn("FAST = False", cell.source)
            changed += times
    began = perf_counter()
    status = "complete"
    with tempfile.TemporaryDirectory() as folder:
        place = {"metadata": {"path": folder}}
        try:
            NotebookClient(
                notebook, timeout=_LONGEST, kernel_name="python3", resources=place
            ).execute()
        except CellExecutionError as error:
            status = f"{error.ename}: {error.evalue}"
    took = perf_counter() - began
    return {
        "notebook": path.stem,
        "cells": len(cells),
        "longer than in tests": changed,
        "wall_s": took,
        "status": status,
    }


def main() -> int:
    """All notebooks, or those that are named; exit code 1 where one fails."""
    parser = parser_of(__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="without its ending; default: all")
    arguments, run = begin(parser)
    if arguments.names:
        names = arguments.names
    elif run.quick:
        names = QUICK
    else:
        names = [path.stem for path in sorted(FOLDER.glob("*.ipynb"))]
    rows = []
    for name in names:
        rows.append(executed(FOLDER / f"{name}.ipynb", fast=run.quick))
        sys.stderr.write(f"{name}: {rows[-1]['status']}\n")
    complete = count_where(rows, "status", "complete")
    prose = PROSE.format(
        run=complete,
        number=len(rows),
        mode=" as in the tests" if run.quick else " in full",
        total=sum(column(rows, "wall_s")),
    )
    columns = dict.fromkeys(rows[0], "") | {"wall_s": ".0f"}
    run.write(
        Report(
            name="notebooks",
            title="Notebooks",
            prose=prose,
            tables=[Table(rows=rows, columns=columns)],
        )
    )
    return int(complete < len(rows))


if __name__ == "__main__":
    sys.exit(main())
