"""Rows of a long study, kept in a folder: a run that was interrupted goes on where it was."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from recording.progress import show_progress
from recording.report import Row
from uvms_ocp.campaign.study import Study

_BATCH = 8  # cases of each process between two looks at the clock


class KeptRows:
    """Runs the cases of a study that are not known yet, and remembers their rows, one line of a file each.

    It does not know what the rows were measured of: after a change of the code, take another folder.
    """

    def __init__(self, work: Path, jobs: int) -> None:
        work.mkdir(parents=True, exist_ok=True)
        self._file, self._jobs = work / "rows.jsonl", jobs

    def run(self, study: Study, hours: float) -> list[Row]:
        """Rows in the order of the cases, of those that are known once `hours` [h] are over."""
        known, end = self._known(), time.monotonic() + 3600.0 * hours
        left = [case for case in study.cases if key_of(case) not in known]
        with ProcessPoolExecutor(self._jobs) as pool, self._file.open("a", encoding="utf-8") as file:
            n = _BATCH * self._jobs
            batches = [left[k : k + n] for k in range(0, len(left), n)]
            for number, batch in enumerate(batches):
                if time.monotonic() >= end:
                    break
                for case, row in zip(batch, pool.map(study.run_case, batch), strict=True):
                    known[key_of(case)] = row
                    file.write(json.dumps({"case": case, "row": dict(row)}) + "\n")
                    file.flush()
                show_progress(number + 1, len(batches))
        return [known[key_of(case)] for case in study.cases if key_of(case) in known]

    def _known(self) -> dict[str, Row]:
        lines = self._file.read_text(encoding="utf-8").splitlines() if self._file.exists() else []
        kept = [json.loads(line) for line in lines if line.endswith("}}")]  # a line cut short is tried again
        return {key_of(item["case"]): item["row"] for item in kept}


def key_of(case: Mapping[str, Any]) -> str:
    """The same for the same case."""
    return json.dumps(case, sort_keys=True)


def spread_out(cases: Sequence[Any], stride: int) -> list[Any]:
    """The same cases in an order of which any beginning is a fair share."""
    return [case for first in range(stride) for case in cases[first::stride]]
