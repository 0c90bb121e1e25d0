"""Rows of a long study, kept in a folder: a run that was interrupted goes on where it was."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from pathlib import Path
from typing import Any

from recording.progress import show_progress
from recording.report import Row
from uvms_ocp.campaign.study import Study

_ROUND = 7  # cases, from all over a study, that are run one after the other


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
        left = _spread_out([case for case in study.cases if key_of(case) not in known])
        done, queue, running = 0, iter(left), dict[Future[Row], Any]()
        with ProcessPoolExecutor(self._jobs) as pool, self._file.open("a", encoding="utf-8") as file:
            while True:
                while len(running) < self._jobs and time.monotonic() < end and (case := next(queue, None)):
                    running[pool.submit(study.run_case, case)] = case
                if not running:
                    break
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    case, row = running.pop(future), dict(future.result())
                    known[key_of(case)], done = row, done + 1
                    file.write("\n" + json.dumps({"case": case, "row": row}))  # a line cut short stays alone
                    file.flush()
                    show_progress(done, len(left))
        return [known[key_of(case)] for case in study.cases if key_of(case) in known]

    def _known(self) -> dict[str, Row]:
        lines = self._file.read_text(encoding="utf-8").splitlines() if self._file.exists() else []
        kept = [json.loads(line) for line in lines if line.endswith("}}")]
        return {key_of(item["case"]): item["row"] for item in kept}


def key_of(case: Mapping[str, Any]) -> str:
    """The same for the same case."""
    return json.dumps(case, sort_keys=True)


def _spread_out(cases: Sequence[Any]) -> list[Any]:
    """The same cases in an order of which any beginning is a fair share."""
    stride = max(1, len(cases) // _ROUND)
    return [case for first in range(stride) for case in cases[first::stride]]
