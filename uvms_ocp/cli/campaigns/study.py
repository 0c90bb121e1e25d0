"""A study from the command line: its cases are runs of a campaign, and its table is printed."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from uvms_ocp.campaign import STUDIES, StudyResult
from uvms_ocp.cli.campaigns.campaign_output import progress_bar
from uvms_ocp.cli.options import default_folder, require_taken
from uvms_ocp.cli.printing import print_json, print_line, print_paths, table_of
from uvms_ocp.exceptions import OutputError
from uvms_ocp.output.durable import write_durably

INTERRUPTED = 130


def make_study(
    name: str,
    options: Mapping[str, Any],
    console: Console,
    *,
    out: Path | None,
    cluster: Mapping[str, Any] | None = None,
    as_json: bool = False,
) -> None:
    """Run what is not finished of a study, write report.json and runs.csv beside its rows, and print its table.

    Raises what `Study.run` raises, `InvalidInput` for options that it does not have, and `OutputError` where it cannot write.
    """
    require_taken(name, STUDIES[name], options)
    folder = out or default_folder((name,), {key: value for key, value in options.items() if key != "force"})
    study = STUDIES[name](**options)
    with interruptible(folder, console), progress_bar(console) as tell:
        result = study.run(folder, progress=tell, **(cluster or {}))
    try:
        write_durably(folder / "report.json", json.dumps(result.to_dict(), indent=2) + "\n")
        result.write_csv(folder / "runs.csv")
    except OSError as error:
        raise OutputError(f"{folder}: cannot write the table ({error.strerror})") from error
    _print_study(result, console)
    print_paths(console, [folder])
    if as_json:
        print_json(result.to_dict())


@contextmanager
def interruptible(folder: Path, console: Console) -> Iterator[None]:
    """Ctrl-C says how to go on."""
    try:
        yield
    except KeyboardInterrupt:
        text = f"stopped; what is finished is in {folder}, and the same command goes on with the rest"
        print_line(console, text, "yellow")
        raise typer.Exit(INTERRUPTED) from None


def _print_study(result: StudyResult, console: Console) -> None:
    rows = result.table
    if len(rows) == 1:  # one wide row reads better downwards
        rows = tuple({"figure": name, "value": value} for name, value in rows[0].items())
    console.print(table_of(result.title, rows, tuple(rows[0])))
