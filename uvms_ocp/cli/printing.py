"""Print tables, findings, paths and JSON."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console, ConsoleOptions
from rich.table import Table

from uvms_ocp.cli.compilation import show_compilation
from uvms_ocp.cli.json_output import print_json as print_json
from uvms_ocp.errors import InvalidInput, plain_line
from uvms_ocp.record.display import cell as cell

if TYPE_CHECKING:
    from uvms_ocp.scenario.preflight.findings import PreflightReport

_TYPED = ("figure", "parameter", "channel")  # columns of names that are typed again: never broken
_SHORT = 20  # letters of a word that is not broken either
_PADDING = 3  # letters that a column takes beside its text


def console_of(*, stderr: bool = False) -> Console:
    """Return a console that takes names for text: no markup, no emoji."""
    return Console(stderr=stderr, markup=False, emoji=False)


@contextmanager
def busy(console: Console, text: str) -> Iterator[Callable[[str], None]]:
    """Show a line on a terminal meanwhile: the text, what is being compiled, or what the function
    yielded is called with.
    """
    with console.status(text) as status, show_compilation(status.update):
        yield status.update


def print_paths(console: Console, paths: Iterable[Path]) -> None:
    """Print one path per line, as it is."""
    for path in paths:
        console.print(str(path), highlight=False, soft_wrap=True)


def print_line(console: Console, text: str, style: str = "") -> None:
    """Print a text, whatever it holds, as one line, which goes on below between two words where the
    console is narrower.
    """
    lines = textwrap.wrap(
        plain_line(text),
        console.width,
        subsequent_indent="  ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    console.print("\n".join(lines), style=style, highlight=False, soft_wrap=True)


def table_of(
    title: str, rows: Sequence[Mapping[str, Any]], columns: tuple[str, ...]
) -> FoldingTable:
    """Return a table of the given columns of all rows."""
    cells = []
    for column in columns:
        cells.append(tuple(cell(row[column]) for row in rows))
    head = tuple(map(plain_line, columns))
    return FoldingTable(title=plain_line(title), head=head, cells=tuple(cells))


@dataclass(frozen=True, kw_only=True, slots=True)
class FoldingTable:
    """A table that breaks no short word: columns for which a console has no room come below, beside
    the first one again.
    """

    title: str
    head: tuple[str, ...]
    cells: tuple[tuple[str, ...], ...]
    """Texts of the cells, column by column."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Table]:
        """Give Rich the tables that fit its width."""
        needs = [self._need(k) for k in range(len(self.head))]
        title: str | None = self.title
        for part in _parts(needs, options.max_width):
            yield self._table(title, part, needs)
            title = None

    def _table(self, title: str | None, part: Sequence[int], needs: Sequence[int]) -> Table:
        table = Table(title=title)
        for k in part:
            fits = max(map(len, (self.head[k], *self.cells[k]))) <= needs[k]
            is_whole = fits or self.head[k] in _TYPED
            table.add_column(self.head[k], overflow="fold", no_wrap=is_whole)
        columns = [self.cells[k] for k in part]
        for row in zip(*columns, strict=True):
            table.add_row(*row)
        return table

    def _need(self, k: int) -> int:
        """Return how many letters a column is wide at least, as some of its words are not
        broken.
        """
        texts = (self.head[k], *self.cells[k])
        if self.head[k] in _TYPED:
            return max(map(len, texts))
        width = 1
        for text in texts:
            for word in text.split():
                if len(word) <= _SHORT:
                    width = max(width, len(word))
        return width


def _parts(needs: Sequence[int], width: int) -> list[list[int]]:
    """Return the columns of tables that each fit a width [letters], all of them with the first
    column; needs: letters of each column.
    """
    room = width - needs[0] - _PADDING - 1
    parts = [[0]]
    free = room
    for k, need in enumerate(needs[1:], 1):
        if need + _PADDING > free and len(parts[-1]) > 1:
            parts.append([0])
            free = room
        parts[-1].append(k)
        free -= need + _PADDING
    return parts


def require_accepted(
    preflight: PreflightReport, subject: str, console: Console, *, force: bool
) -> None:
    """Print what pre-flight has found of a mission.

    Raises `InvalidInput` for one that it refuses, unless forced; that is the only line then on a
    stderr that is no terminal.
    """
    refused = not (preflight.accepted or force)
    if not refused or not console.stderr or console.is_terminal:
        print_findings(console, preflight)
    if refused:
        n = len(preflight.errors)
        plural = "s" if n > 1 else ""
        raise InvalidInput(
            f"pre-flight refuses {subject} ({n} error{plural}): {preflight.errors[0].text};"
            " mend that, or --force runs it all the same"
        )


def print_findings(console: Console, preflight: PreflightReport, *, notes: bool = False) -> None:
    """Print errors and warnings of pre-flight, one per line, and notes if wanted."""
    styles = {"error": "red", "warning": "yellow"}
    for finding in preflight.findings:
        severity = finding.severity.value
        if notes or severity in styles:
            phase_text = f" (phase {finding.phase})" if finding.phase else ""
            text = f"{severity}: {finding.check}{phase_text}: {finding.text}"
            print_line(console, text, styles.get(severity, ""))
    if notes:
        verdict = "accepted" if preflight.accepted else "refused"
        console.print(f"pre-flight: {verdict}", highlight=False)
