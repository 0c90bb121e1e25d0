"""Run long studies in parts: rows are kept in a folder, where the next run goes on."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from studies.study import Study, finished_rows

from recording.progress import show_progress
from recording.report import Report, Row, Table, add_jobs_option
from uvms_ocp.campaign.store import part_paths

_ROUND = 7  # number of cases, from all over a study, that are run one after the other


class OverTime(Exception):
    """The time of a study is over."""


def add_study_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a study that goes on where its last run ended."""
    add_jobs_option(parser)
    parser.add_argument("--work", type=Path, metavar="PATH", help="folder of rows that are kept")
    parser.add_argument(
        "--hours", type=float, default=24.0, metavar="H", help="time after which it ends [h]"
    )


def kept_rows(study: Study, folder: Path, jobs: int, hours: float) -> list[Row]:
    """Run cases for `hours` [h] at most; return the rows of the finished ones, in the order of the
    cases.
    """
    end = time.monotonic() + 3600.0 * hours
    order = spread_out(range(len(study.cases)))

    def tell(done: int, failed: int, total: int) -> None:
        show_progress(done, total)
        if time.monotonic() > end:
            raise OverTime

    spread = replace(study, cases=[study.cases[k] for k in order])
    with suppress(OverTime):
        spread.run(folder, workers=jobs, progress=tell)
    if not part_paths(folder):
        return []
    row_of_case = {order[run]: row for run, row in finished_rows(folder).items()}
    return [row_of_case[case] for case in sorted(row_of_case)]


def study_report(study: Study, title: str, rows: list[Row], prose: str) -> Report:
    """Return the report of a study: prose, the table that sums up its rows, and these as data."""
    return Report(
        name=study.name,
        title=title,
        prose=prose,
        tables=[Table(rows=study.summarize(rows))],
        data={study.name: rows},
    )


def spread_out(cases: Sequence[int]) -> list[int]:
    """Order cases so that any beginning is a fair share of all."""
    stride = max(1, len(cases) // _ROUND)
    order = list[int]()
    for first in range(stride):
        order += cases[first::stride]
    return order
