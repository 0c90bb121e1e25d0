"""A study as a campaign: its cases on a cluster, kept as they finish, resumed after any kill."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from uvms_ocp.campaign.execution.carry_out import Progress, carry_out
from uvms_ocp.campaign.runs.work import COMPLETED, Done, Row, Work, columns_of
from uvms_ocp.campaign.store.identity import Identity
from uvms_ocp.campaign.store.table import read_table
from uvms_ocp.campaign.study import Study, StudyResult
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.version import __version__

_ROW = "row"
_SUCCESS = ("completed", "passed")  # columns of studies that tell of it


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class StudyRuns(Work):
    """Run k is case k; its row, of any columns, is kept as JSON."""

    study: Study

    @property
    def columns(self) -> Mapping[str, type]:
        return {_ROW: str}

    def head(self, run: int) -> Row:
        """Nothing but the number of a run [-]."""
        return {}

    def make(self, run: int) -> Done:
        """The row of a run [-]."""
        row = dict(self.study.run_case(self.study.cases[run]))
        success = next((bool(row[name]) for name in _SUCCESS if name in row), True)
        outcome = COMPLETED if success else str(row.get("end", row.get("cause", "failed")))
        told = {"outcome": outcome, "success": success, "cause": str(row.get("text", row.get("cause", "")))}
        return Done(row={_ROW: json.dumps(row), **told})


def study_identity(study: Study) -> Identity:
    """By which a folder knows it again."""
    cases = hashlib.sha256(repr(list(study.cases)).encode()).hexdigest()
    return Identity(
        name=study.name,
        package=__version__,
        runs=len(study.cases),
        seed=0,
        sampler="random",
        parameters={},
        columns={name: kind.__name__ for name, kind in columns_of(StudyRuns(study=study)).items()},
        scenario={"study": study.name, "cases": cases},
        variations={"values": []},
        records="none",
    )


def carry_out_study(
    study: Study,
    out: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> StudyResult:
    """Make all cases that are not finished in the folder `out`, and sum them up; workers [-]: processes of this machine.

    Raises what `carry_out` raises, and `InvalidInput` for cases that raised or ended their process: they stay in the folder.
    """
    work = StudyRuns(study=study)
    carry_out(out, study_identity(study), work, workers=workers, scheduler=scheduler, progress=progress)
    table = read_table(out)
    failed = table[table[_ROW].isna()]
    if len(failed):
        first = failed.iloc[0]
        text = f"{len(failed)} of {len(table)} cases made no row, such as {first['run']}: {first['cause']}"
        raise InvalidInput(f"{out}: {text}; mend it and take a new folder")
    rows = tuple(json.loads(text) for text in table[_ROW])
    return StudyResult(name=study.name, title=study.title, cases=rows, table=tuple(study.summarize(rows)))
