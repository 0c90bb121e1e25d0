"""Job of a campaign: run k of one scenario, with the values of its parameters that the design has drawn."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from uvms_ocp.campaign import jobs, run_metrics
from uvms_ocp.campaign.code_source import CodeSource
from uvms_ocp.campaign.sampling_design import Design
from uvms_ocp.campaign.variations import Variation, quantiles, vary
from uvms_ocp.errors import require_known
from uvms_ocp.record.record import Record
from uvms_ocp.report.end_of_run import cause_of_end
from uvms_ocp.scenario.scenario import Scenario

KEPT = ("none", "failures", "all")
"""Choices of runs that keep their whole record."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MissionJob(jobs.CampaignJob):
    """Runs of a scenario, as workers get them. Raises `NameNotFound` for unknown `records`."""

    scenario: CodeSource | Callable[[], Scenario]
    """Code of the scenario, or a function that makes it."""
    variations: CodeSource | Sequence[Variation]
    """Code of the variations, or the values themselves."""
    names: tuple[str, ...]
    """Names of the parameters, in their order."""
    design: Design
    """Numbers from 0 to 1 for all parameters of all runs."""
    records: str = "none"
    """Runs that keep their whole record: one of `KEPT`."""

    def __post_init__(self) -> None:
        require_known("choice of records", self.records, KEPT)

    @property
    def columns(self) -> Mapping[str, type]:
        """Names and types of the columns of a row."""
        numbers = (*self.names, *run_metrics.METRICS, *run_metrics.tool_metrics(self.base().robot))
        return {"seed": int, **dict.fromkeys(numbers, float), "finished": bool}

    def head(self, run: int) -> jobs.Row:
        """Return the seed and the values of the parameters of a run."""
        return {"seed": self.design.seed_of(run), **self.values(run)}

    def values(self, run: int) -> dict[str, float]:
        """Return values [unit of each] of the parameters of a run, by name."""
        return quantiles(built(self.variations), self.design.row(run).tolist())

    def scenario_of(self, run: int) -> Scenario:
        """Build the scenario of a run."""
        return vary(
            self.base(),
            self.values(run),
            variations=built(self.variations),
            seed=self.design.seed_of(run),
        )

    def base(self) -> Scenario:
        """Return the scenario that is varied."""
        return made_once(self.scenario)

    def make(self, run: int) -> jobs.RunResult:
        """Make the row of a run, and its record where that is to be kept."""
        scenario = self.scenario_of(run)
        record = scenario.run()
        try:
            return self._result(run, scenario, record)
        except Exception as error:  # the record is kept even where its metrics fail
            row = jobs.failed_row(self, run, jobs.ERROR, jobs.describe(error))
            attachment = b""
            if self.records != "none":
                attachment = _packed(record)
            return jobs.RunResult(row=row, attachment=attachment)

    def _result(self, run: int, scenario: Scenario, record: Record) -> jobs.RunResult:
        """Make the row of a run from its record."""
        cause = cause_of_end(record)
        success = cause["kind"] == jobs.COMPLETED
        ending = {
            "outcome": cause["kind"],
            "success": success,
            "cause": cause["text"],
            "finished": record.run_meta.completed,
        }
        attachment = b""
        if self.records == "all" or (self.records == "failures" and not success):
            attachment = _packed(record)
        row = {**self.head(run), **run_metrics.run_metrics(scenario, record), **ending}
        return jobs.RunResult(row=row, attachment=attachment)


def built(variations: CodeSource | Sequence[Variation]) -> Sequence[Variation]:
    """Return the variations; those of a file are loaded once in a process."""
    if isinstance(variations, CodeSource):
        return made_once(variations)
    return variations


@lru_cache(maxsize=4)
def made_once(source: CodeSource | Callable[[], Any]) -> Any:
    """Make a scenario, or variations, once in a process: what runs share, such as the robot, is then the
    same object.
    """
    if isinstance(source, CodeSource):
        return source.build()
    return source()


def _packed(record: Record) -> bytes:
    """Return the file of a record as bytes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "record.npz")
        record.save(path)
        return path.read_bytes()
