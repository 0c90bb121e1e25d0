"""The files of a benchmark: one writer for all of them."""

from __future__ import annotations

import argparse
import csv
import os
import re
import sys
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from recording.head import Beginning, Head, this_command

_WIDTH = 124
RESULTS = Path(__file__).parents[1] / "results"
Row: TypeAlias = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True, slots=True)
class Table:
    """Rows as Markdown shows them."""

    rows: Sequence[Row]
    columns: Mapping[str, str] = field(default_factory=dict)
    """Format of a column by its name; all columns, in the order of the rows, where none is
    given.
    """

    def lines(self) -> list[str]:
        """Markdown."""
        columns = self.columns or dict.fromkeys(columns_of(self.rows), "")
        lines = ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
        for row in self.rows:
            cells = [cell(row.get(name), form) for name, form in columns.items()]
            lines.append("| " + " | ".join(cells) + " |")
        return lines


@dataclass(frozen=True, kw_only=True, slots=True)
class Report:
    """Prose, tables and data of a benchmark. Every file of it begins with the head of its run."""

    name: str
    """Name of its files, without their endings."""
    title: str
    prose: str
    """Text below the head; every figure in it is computed."""
    tables: Sequence[Table]
    data: Mapping[str, Sequence[Row]] = field(default_factory=dict)
    """Rows of each CSV file by its name without ending; by default those of the first table."""
    peers: Mapping[str, str] = field(default_factory=dict)
    """Versions of the packages that were measured for comparison."""

    def markdown(self, head: Head) -> str:
        """The whole report below its head."""
        parts = [f"# {self.title}", "\n".join(_flowing(head.lines())), filled(self.prose)]
        parts += ["\n".join(table.lines()) for table in self.tables]
        return "\n\n".join(parts) + "\n"

    def write(self, folder: Path, head: Head) -> list[Path]:
        """Write Markdown and CSV; returns their paths."""
        folder.mkdir(parents=True, exist_ok=True)
        report = folder / f"{self.name}.md"
        report.write_text(self.markdown(head), encoding="utf-8")
        paths = [report]
        data = self.data or {self.name: self.tables[0].rows}
        for name, rows in data.items():
            path = folder / f"{name}.csv"
            _write_csv(rows, path, head)
            paths.append(path)
        return paths


@dataclass(frozen=True, kw_only=True, slots=True)
class Run:
    """One run of a benchmark, from its command line to its files."""

    out: Path
    quick: bool
    beginning: Beginning

    def write(self, report: Report) -> None:
        """Write the files, print the report, and warn where the machine was not quiet."""
        head = self.beginning.head(report.peers)
        paths = report.write(self.out, head)
        sys.stdout.write(report.markdown(head))
        if not head.quiet:
            sys.stderr.write(f"warning: {head.load}\n")
        sys.stderr.write("".join(f"wrote {path}\n" for path in paths))


def parser_of(doc: str | None) -> argparse.ArgumentParser:
    """Make a parser with the options that every benchmark has."""
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="little work, to see that it runs; needs --out"
    )
    parser.add_argument(
        "--out", type=Path, default=RESULTS, metavar="PATH", help="folder of the files"
    )
    return parser


def add_jobs_option(parser: argparse.ArgumentParser) -> None:
    """Add the option of benchmarks whose cases run beside each other."""
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help="processes"
    )


def begin(parser: argparse.ArgumentParser) -> tuple[argparse.Namespace, Run]:
    """Parse the command line and start to watch the processors; a quick run must not replace
    recorded files.

    What is timed is compiled before.
    """
    os.environ.setdefault("UVMS_OCP_WAIT_FOR_COMPILER", "1")
    arguments = parser.parse_args()
    if arguments.quick and arguments.out.resolve() == RESULTS:
        parser.error(
            "--quick measures too little to be recorded; give another folder with --out PATH"
        )
    return arguments, Run(
        out=arguments.out, quick=arguments.quick, beginning=Beginning(this_command())
    )


def columns_of(rows: Sequence[Row]) -> list[str]:
    """All columns of the rows, in the order in which they first occur."""
    columns: dict[str, None] = {}
    for row in rows:
        columns |= dict.fromkeys(row)
    return list(columns)


def filled(text: str) -> str:
    """Paragraphs and lists in lines of one length."""
    paragraphs = []
    for paragraph in text.strip().split("\n\n"):
        items = [_filled(item) for item in _items(paragraph)]
        paragraphs.append("\n".join(items))
    return "\n\n".join(paragraphs)


def _items(paragraph: str) -> list[str]:
    """The items of a list; a paragraph that is none, as it is."""
    if not paragraph.startswith("- "):
        return [paragraph]
    return re.split(r"\n(?=- )", paragraph)


def _filled(item: str) -> str:
    indent = "  " if item.startswith("- ") else ""
    text = " ".join(item.split())
    return textwrap.fill(
        text, _WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def cell(value: Any, form: str = "") -> str:
    """A value as text: three digits of a number that has no format of its own."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        default_form = ".0f" if abs(value) >= 1e3 else ".3g"
        return format(value, form or default_form)
    if form and isinstance(value, int):
        return format(value, form)
    return str(value).replace("|", "\\|")


def _flowing(lines: Sequence[str]) -> list[str]:
    """Lines that Markdown keeps apart."""
    return [f"{line}  " for line in lines[:-1]] + [lines[-1]]


def _write_csv(rows: Sequence[Row], path: Path, head: Head) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        file.writelines(f"# {line}\n" for line in head.lines())
        table = csv.DictWriter(file, columns_of(rows), restval="", lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
