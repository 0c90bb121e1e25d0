"""A study: independent cases on a cluster, kept as they finish, and a table made of their rows."""

from __future__ import annotations

import csv
import hashlib
import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

from uvms_ocp.campaign.cluster import Progress, Workers, run_jobs
from uvms_ocp.campaign.jobs import COMPLETED, CampaignJob, Row, RunResult
from uvms_ocp.campaign.manifest import CampaignManifest, types_of
from uvms_ocp.campaign.store import read_table
from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.display import FieldTable, SmallTable, TableDisplay, format_value
from uvms_ocp.record.durable_files import write_durably
from uvms_ocp.types import Period
from uvms_ocp.version import __version__

_MOST_RUNS = 1_000_000
_ROW = "row"
_FAILED = "failed"
_SUCCESS = ("completed", "passed")  # columns of studies that tell whether a case succeeded


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class StudyResult(TableDisplay):
    """Rows of all cases, and the table that sums them up."""

    name: str
    """Name of the study."""
    title: str
    """Title of its table."""
    cases: tuple[Row, ...]
    """Row of each case."""
    table: tuple[Row, ...]
    """Rows that sum them up."""

    def _table(self) -> SmallTable:
        head = tuple(self.table[0]) if self.table else ()
        rows = tuple(tuple(map(format_value, row.values())) for row in self.table)
        title = f"{self.title} ({len(self.cases)} cases)"
        return SmallTable(title=title, head=head, rows=rows)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as JSON values."""
        cases = [dict(row) for row in self.cases]
        table = [dict(row) for row in self.table]
        return {"study": self.name, "title": self.title, "table": table, "cases": cases}

    def write_csv(self, path: Path) -> None:
        """Write the rows of all cases as a CSV file; columns are those of the first row. Raises
        `OSError`.
        """
        text = StringIO(newline="")
        writer = csv.DictWriter(text, fieldnames=list(self.cases[0]) if self.cases else [])
        writer.writeheader()
        writer.writerows(self.cases)
        write_durably(path, text.getvalue())


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Study(FieldTable):
    """A study of cases that are run in other processes."""

    name: str
    """Name of the study, and of its files."""
    title: str
    """Title of its table."""
    cases: Sequence[Any]
    """Arguments of `run_case`, one for each case."""
    run_case: Callable[[Any], Row]
    """Runs a case and returns its row."""
    summarize: Callable[[Sequence[Row]], Sequence[Row]]
    """Makes the table of the rows of all cases."""

    def run(
        self,
        out: Path | None = None,
        *,
        workers: Workers | None = None,
        scheduler: str | None = None,
        time_limit: Period = 3600.0,
        progress: Progress | None = None,
    ) -> StudyResult:
        """Run all cases but those whose rows the folder `out` has already, and sum them up; without
        a folder no rows are kept.

        workers, scheduler, time_limit [s] and errors: those of `Campaign.run`. Raises `InvalidInput`
        also for cases that raised or ended their process, which stay in the folder.
        """
        if out is None:
            with tempfile.TemporaryDirectory() as folder:
                options: dict[str, Any] = {
                    "workers": workers,
                    "scheduler": scheduler,
                    "time_limit": time_limit,
                }
                return self.run(Path(folder, "study"), progress=progress, **options)
        work = _Cases(study=self)
        cluster = dict[str, Any](workers=workers, scheduler=scheduler, limit=time_limit)
        run_jobs(out, self._identity(work), work, progress=progress, **cluster)
        rows = tuple(finished_rows(out).values())
        return StudyResult(
            name=self.name, title=self.title, cases=rows, table=tuple(self.summarize(rows))
        )

    def _identity(self, work: CampaignJob) -> CampaignManifest:
        cases = hashlib.sha256(repr(list(self.cases)).encode()).hexdigest()
        return CampaignManifest(
            name=self.name,
            package=__version__,
            runs=len(self.cases),
            seed=0,
            sampler="random",
            parameters={},
            columns=types_of(work),
            scenario={"study": self.name, "cases": cases},
            variations={"values": []},
            records="none",
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Cases(CampaignJob):
    """Job of a campaign whose run k is case k; its row, of any columns, is kept as JSON."""

    study: Study

    @property
    def columns(self) -> Mapping[str, type]:
        return {_ROW: str}

    def head(self, run: int) -> Row:
        return {}

    def make(self, run: int) -> RunResult:
        row = dict(self.study.run_case(self.study.cases[run]))
        success = next((bool(row[name]) for name in _SUCCESS if name in row), True)
        outcome = COMPLETED
        if not success:
            outcome = str(row.get("end", row.get("cause", _FAILED)))
        if not success and outcome == COMPLETED:
            outcome = _FAILED  # it ended well and did not pass
        cause = str(row.get("text", row.get("cause", "")))
        return RunResult(
            row={_ROW: json.dumps(row), "outcome": outcome, "success": success, "cause": cause}
        )


def finished_rows(out: Path) -> dict[int, Row]:
    """Read the rows of the finished cases of a study, by number. Raises `InvalidInput` where some
    raised or ended their process.
    """
    table = read_table(out)
    failed = table[table[_ROW].isna()]
    if len(failed):
        first = failed.iloc[0]
        text = (
            f"{len(failed)} of {len(table)} cases made no row, such as {first['run']}:"
            f" {first['cause']}"
        )
        raise InvalidInput(f"{out}: {text}; mend it and take a new folder")
    return {int(run): json.loads(text) for run, text in zip(table["run"], table[_ROW], strict=True)}


def seeded_study(
    name: str,
    title: str,
    *,
    n: int,
    seed: int,
    run_case: Callable[[Any], Row],
    summarize: Callable[[Sequence[Row]], Sequence[Row]],
) -> Study:
    """Make a study of n cases that are drawn by their seeds alone, ``{"seed": seed}`` and those after
    it. Raises `InvalidInput` for no cases or too many.
    """
    return Study(
        name=name,
        title=title,
        cases=[{"seed": case_seed} for case_seed in seeds_from(seed, n)],
        run_case=run_case,
        summarize=summarize,
    )


def seeds_from(seed: int, n: int) -> range:
    """Return the seeds of n drawn cases, from `seed` on. Raises `InvalidInput` for no cases or too
    many.
    """
    if n < 1:
        raise InvalidInput(f"n = {n} runs of a study; give 1 or more")
    if n > _MOST_RUNS:
        raise InvalidInput(
            f"n = {n} runs of a study; give at most {_MOST_RUNS:,}: the table keeps a row of each"
        )
    return range(seed, seed + n)
