"""What commands print: tables, findings, paths, JSON."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from uvms_ocp.exceptions import plain_line
from uvms_ocp.preflight.findings import PreflightReport, Severity

_TYPED = ("figure", "parameter", "channel")  # columns of names that are typed again: never broken


def print_json(value: Any) -> None:
    """One JSON value on stdout."""
    sys.stdout.write(json.dumps(value, indent=2) + "\n")


def console_of(*, stderr: bool = False) -> Console:
    """A console that takes names for text: no markup, no emoji."""
    return Console(stderr=stderr, markup=False, emoji=False)


def print_paths(console: Console, paths: Iterable[Path]) -> None:
    """One path per line, as it is."""
    for path in paths:
        console.print(str(path), highlight=False, soft_wrap=True)


def table_of(title: str, rows: Sequence[Mapping[str, Any]], columns: tuple[str, ...]) -> Table:
    """A table of the given columns of all rows."""
    table = Table(title=plain_line(title))
    for column in columns:
        table.add_column(plain_line(column), overflow="fold", no_wrap=column in _TYPED)
    for row in rows:
        table.add_row(*(cell(row[column]) for column in columns))
    return table


def cell(value: Any) -> str:
    """A value as a table shows it."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else plain_line(str(value))


def print_findings(console: Console, preflight: PreflightReport, *, notes: bool = False) -> None:
    """Errors and warnings of pre-flight, one per line, and notes if wanted."""
    styles = {Severity.ERROR: "red", Severity.WARNING: "yellow", Severity.NOTE: ""}
    for finding in preflight.findings:
        if notes or finding.severity is not Severity.NOTE:
            where = f" (phase {finding.phase})" if finding.phase else ""
            text = plain_line(f"{finding.severity.value}: {finding.check}{where}: {finding.text}")
            console.print(text, style=styles[finding.severity], highlight=False, soft_wrap=True)
    if notes:
        verdict = "accepted" if preflight.accepted else "refused"
        console.print(f"pre-flight: {verdict}", highlight=False)
