"""A study: independent cases, run one by one or in parallel, and a table made of their rows."""

from __future__ import annotations

import csv
import pickle
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from uvms_ocp.arguments import Range, checked
from uvms_ocp.exceptions import InvalidInput

_MOST_RUNS = 1_000_000
_MOST_JOBS = 4096
Row = Mapping[str, Any]
"""One line of a table: plain values by column name."""


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class StudyResult:
    """Rows of all cases, and the table that sums them up."""

    name: str
    title: str
    cases: tuple[Row, ...]
    table: tuple[Row, ...]

    def to_dict(self) -> dict[str, Any]:
        """JSON values only."""
        cases, table = [dict(row) for row in self.cases], [dict(row) for row in self.table]
        return {"study": self.name, "title": self.title, "table": table, "cases": cases}

    def write_csv(self, path: Path) -> None:
        """The rows of all cases as a CSV file; columns are those of the first row."""
        with path.open("w", newline="") as file:
            writer = csv.DictWriter(file, fieldnames=list(self.cases[0]) if self.cases else [])
            writer.writeheader()
            writer.writerows(self.cases)


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Study:
    """Cases are arguments of `run_case`, a function at module level so that other processes find it."""

    name: str
    title: str
    cases: Sequence[Any]
    run_case: Callable[[Any], Row]
    summarize: Callable[[Sequence[Row]], Sequence[Row]]

    def run(
        self, *, jobs: Annotated[int, Range(1, _MOST_JOBS)] = 1, progress: Callable[[int, int], None] | None = None
    ) -> StudyResult:
        """All cases, in `jobs` processes; `progress` is told how many of them are done, and of how many.

        Raises `InvalidInput` for several processes where they cannot find `run_case` or get a case.
        """
        if jobs > 1:
            _check_sent(self.run_case, self.cases)
        rows = []
        for row in _mapped(self.run_case, self.cases, jobs):
            rows.append(row)
            if progress is not None:
                progress(len(rows), len(self.cases))
        return StudyResult(name=self.name, title=self.title, cases=tuple(rows), table=tuple(self.summarize(rows)))


def seeds_from(seed: int, n: int) -> range:
    """`seed`, `seed` + 1, ... of `n` drawn cases. Raises `InvalidInput` for no cases or too many."""
    if n < 1:
        raise InvalidInput(f"n = {n} runs of a study; give 1 or more")
    if n > _MOST_RUNS:
        raise InvalidInput(f"n = {n} runs of a study; give at most {_MOST_RUNS:,}: the table keeps a row of each")
    return range(seed, seed + n)


def _check_sent(function: Callable[[Any], Row], cases: Sequence[Any]) -> None:
    try:
        pickle.dumps((function, cases))
    except Exception as error:  # what values raise that cannot be sent is their own
        reason = " ".join(str(error).split())
        raise InvalidInput(f"jobs > 1, but other processes cannot get run_case and cases ({reason}); give 1") from error


def _mapped(function: Callable[[Any], Row], cases: Sequence[Any], jobs: int) -> Any:
    if jobs <= 1:
        yield from map(function, cases)
        return
    with ProcessPoolExecutor(max_workers=jobs) as pool:
        yield from pool.map(function, cases)
