"""The runs of one scenario with everything varied that is to be."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from uvms_ocp.campaign.runs.code_source import CodeSource
from uvms_ocp.campaign.runs.merits import MERITS, merits
from uvms_ocp.campaign.runs.work import COMPLETED, Done, Row, Work
from uvms_ocp.campaign.variations.samplers import Design
from uvms_ocp.campaign.variations.variation import Variation, quantiles, varied
from uvms_ocp.exceptions import NameNotFound
from uvms_ocp.record import Record
from uvms_ocp.report.cause import cause_of_end
from uvms_ocp.scenario import Scenario

KEPT = ("none", "failures", "all")
"""Which runs keep their whole record."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MissionRuns(Work):
    """Goes to workers. Raises `NameNotFound` for unknown `records`."""

    scenario: CodeSource | Callable[[], Scenario]
    """Or a function that makes it."""
    variations: CodeSource | Sequence[Variation]
    """Or the values themselves."""
    names: tuple[str, ...]
    """Of the parameters, in their order."""
    design: Design
    """Which values they have."""
    records: str = "none"
    """One of `KEPT`."""
    _columns: dict[str, type] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.records not in KEPT:
            raise NameNotFound("choice of records", self.records, KEPT)
        own = {"seed": int, **dict.fromkeys(self.names, float), **dict.fromkeys(MERITS, float), "finished": bool}
        object.__setattr__(self, "_columns", own)

    @property
    def columns(self) -> Mapping[str, type]:
        return self._columns

    def head(self, run: int) -> Row:
        """Seed and values of the parameters of a run [-]."""
        return {"seed": self.design.seed_of(run), **self.values(run)}

    def values(self, run: int) -> dict[str, float]:
        """Values [unit of each] of the parameters of a run [-], by name."""
        return quantiles(self._variations(), self.design.row(run).tolist())

    def scenario_of(self, run: int) -> Scenario:
        """What a run [-] simulates."""
        return varied(self.base(), self._variations(), self.values(run), self.design.seed_of(run))

    def base(self) -> Scenario:
        """The scenario that is varied."""
        return _made(self.scenario)

    def make(self, run: int) -> Done:
        """The row of a run [-], and its record where that is to be kept."""
        scenario = self.scenario_of(run)
        record = scenario.run()
        cause = cause_of_end(record)
        success = cause["kind"] == COMPLETED
        told = {"outcome": cause["kind"], "success": success, "cause": cause["text"]}
        told |= {"finished": record.run_meta.completed}
        keep = self.records == "all" or (self.records == "failures" and not success)
        row = {**self.head(run), **merits(scenario, record), **told}
        return Done(row=row, attachment=_packed(record) if keep else b"")

    def _variations(self) -> Sequence[Variation]:
        return built(self.variations)


def built(variations: CodeSource | Sequence[Variation]) -> Sequence[Variation]:
    """The values, of a file loaded once in a process."""
    return _made(variations) if isinstance(variations, CodeSource) else variations


@lru_cache(maxsize=4)
def _made(source: CodeSource | Callable[[], Any]) -> Any:
    """Once in a process: what runs share, such as the robot, is then known to be the same."""
    return source.build() if isinstance(source, CodeSource) else source()


def _packed(record: Record) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "record.npz")
        record.save(path)
        return path.read_bytes()
