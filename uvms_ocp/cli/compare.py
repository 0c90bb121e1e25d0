"""``compare``: two runs, or two plans, side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from uvms_ocp.cli.compiling import told_of_compiling
from uvms_ocp.cli.options import SCENARIO_HELP, Json, build_scenario
from uvms_ocp.cli.printing import console_of, print_json, table_of
from uvms_ocp.exceptions import InvalidInput, plain_line
from uvms_ocp.output import settle
from uvms_ocp.record import Record
from uvms_ocp.report.compare import compare
from uvms_ocp.scenario import Scenario
from uvms_ocp.scenarios import SCENARIOS
from uvms_ocp.scenarios.own_code import own_code

_WHAT = "Folder of a run or of a plan, its record.npz, or what is run first:"


def compare_runs(
    first: Annotated[str, typer.Argument(metavar="A", help=f"{_WHAT} {SCENARIO_HELP}")],
    second: Annotated[str, typer.Argument(metavar="B", help="The other of the same kind.")],
    as_json: Json = False,
) -> None:
    """Compare the resources that two runs took, or two plans would take.

    \f
    Raises `InvalidInput` for a folder without a record.
    """
    console = console_of(stderr=as_json)
    given = [_given(words) for words in (first, second)]  # both, before either is run
    records = [_record(words, one, console) for words, one in zip((first, second), given, strict=True)]
    rows = compare(records[0], records[1])
    shown = [row | {"change": _percent(row["change"])} for row in rows]
    console.print(table_of(f"{first} against {second}", shown, ("figure", "first", "second", "change")))
    if as_json:
        print_json(rows)


def _given(words: str) -> Record | Scenario:
    """A record of a folder or a file, or a scenario to be run."""
    if (Path(words).exists() and own_code(words) is None) or not (own_code(words) or words in SCENARIOS):
        return _load(Path(words))
    return build_scenario(words, {})


def _record(words: str, given: Record | Scenario, console: Console) -> Record:
    if isinstance(given, Record):
        return given
    with console.status(f"running {plain_line(words, 60)}") as status, told_of_compiling(status.update):
        return given.run()


def _load(path: Path) -> Record:
    folder, file = (path, path / "record.npz") if path.is_dir() else (path.parent, path)
    settle(folder)
    if path.is_dir() and not file.is_file():
        raise InvalidInput(f"{path}: holds no record.npz; give the folder of a run, or of a plan of `plan`")
    return Record.load(file)


def _percent(change: float | None) -> str | None:
    return None if change is None else f"{round(change, 4) + 0.0:+.4g} %"  # without the noise of sums, and no -0
