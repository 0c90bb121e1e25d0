"""``compare``: two runs, or two plans, side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from uvms_ocp.cli.options import Json
from uvms_ocp.cli.printing import console_of, print_json, table_of
from uvms_ocp.output import settle
from uvms_ocp.record import Record
from uvms_ocp.report.compare import compare


def compare_runs(
    first: Annotated[Path, typer.Argument(metavar="A", help="Folder of a run or of a plan, or its record.npz.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="The other of the same kind.")],
    as_json: Json = False,
) -> None:
    """Compare the resources that two runs took, or two plans would take."""
    records = [_load(path) for path in (first, second)]
    rows = compare(records[0], records[1])
    console = console_of(stderr=as_json)
    shown = [row | {"change": _percent(row["change"])} for row in rows]
    console.print(table_of(f"{first} against {second}", shown, ("figure", "first", "second", "change")))
    if as_json:
        print_json(rows)


def _load(path: Path) -> Record:
    folder, file = (path, path / "record.npz") if path.is_dir() else (path.parent, path)
    settle(folder)
    return Record.load(file)


def _percent(change: float | None) -> str | None:
    return None if change is None else f"{round(change, 4) + 0.0:+.4g} %"  # without the noise of sums, and no -0
