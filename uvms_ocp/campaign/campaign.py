"""A campaign as a value: a scenario, what is uncertain about it, and how many runs of it."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import field
from pathlib import Path
from typing import Any

from uvms_ocp.campaign import cluster
from uvms_ocp.campaign.code_source import CodeSource
from uvms_ocp.campaign.manifest import (
    MOST_RUNS,
    SOURCES,
    CampaignManifest,
    read_manifest,
    types_of,
)
from uvms_ocp.campaign.mission_job import MissionJob, built
from uvms_ocp.campaign.sampling_design import Design
from uvms_ocp.campaign.store import read_table
from uvms_ocp.campaign.variations import Variation, require_available
from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput, UvmsError, require_known
from uvms_ocp.interrupts import Interrupted
from uvms_ocp.record.display import FieldTable
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.types import AtLeastOne, Count, Period
from uvms_ocp.version import __version__

_PLAIN_FIELDS = ("runs", "seed", "sampler", "records")
"""Fields of a campaign that its folder keeps as they are."""


@checked_dataclass(eq=False, repr=False)
class Campaign(FieldTable):
    """Runs of one scenario with parameters drawn anew for each.

    Raises `NameNotFound` for an unknown parameter or sampler, and `InvalidInput` for numbers that
    make no campaign.
    """

    scenario: str | CodeSource | Callable[[], Scenario]
    """A name, ``file.py:name``, ``package.module:name``, or a function that makes it."""
    variations: str | CodeSource | Sequence[Variation] = ()
    """Uncertain values, or a file that defines `variations`."""
    runs: AtLeastOne = 100
    """Number of runs."""
    seed: Count = 0
    """Seed of everything drawn."""
    sampler: str = "sobol"
    """Random, latin, sobol, or indices, the design that Sobol' indices need."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of a scenario that is given by its name."""
    records: str = "none"
    """Runs that keep their whole record: none, failures or all."""
    work: MissionJob = field(init=False, repr=False)
    """Job that is sent to workers."""

    def __post_init__(self) -> None:
        if self.runs > MOST_RUNS:
            raise InvalidInput(f"{self.runs:,} runs; give at most {MOST_RUNS:,}")
        scenario = _gathered(self.scenario, self.options, "scenario")
        variations = _gathered(self.variations, {}, "variations")
        values: Any = built(variations)
        if not isinstance(values, Sequence) or not all(
            isinstance(value, Variation) for value in values
        ):
            raise InvalidInput(f"variations = {str(values)[:80]}; give a list of Variation values")
        design = Design(
            sampler=self.sampler, runs=self.runs, parameters=len(values), seed=self.seed
        )
        names = tuple(variation.name for variation in values)
        work = MissionJob(
            scenario=scenario,
            variations=variations,
            names=names,
            design=design,
            records=self.records,
        )
        require_available(values, work.base())
        object.__setattr__(self, "work", work)

    def __getitem__(self, name: str) -> Variation:
        """Return the uncertain value of that name. Raises `NameNotFound` with the names there are."""
        require_known("variation", name, self.work.names)
        return next(
            variation for variation in built(self.work.variations) if variation.name == name
        )

    def _ipython_key_completions_(self) -> tuple[str, ...]:
        return self.work.names

    def run(
        self,
        out: Path | str,
        *,
        workers: cluster.Workers | None = None,
        scheduler: str | None = None,
        time_limit: Period = 3600.0,
        progress: cluster.Progress | None = None,
    ) -> Any:
        """Make all runs that are not finished in the folder `out`, and return the table of all: a
        pandas.DataFrame.

        workers: processes of this machine, by default as many as it has processors. scheduler:
        address of a Dask cluster in their place. time_limit [s]: of a run, whose row says so where
        it takes longer. Killed at any moment and called again, it neither loses nor repeats a run
        whose row is on the disk. Raises `InvalidInput` where another campaign is in the folder,
        `OutputError` where it cannot be written, `NotInstalled` without the extra
        ``uvms-ocp[campaign]``, and for Ctrl-C `Interrupted`, whose result is the table so far.
        """
        out = Path(out)
        where: dict[str, Any] = {"workers": workers, "scheduler": scheduler}
        try:
            cluster.run_jobs(
                out,
                self.identity(),
                self.work,
                self.sources(),
                **where,
                limit=time_limit,
                progress=progress,
            )
        except KeyboardInterrupt:
            raise self._interrupted(out) from None
        return read_table(out)

    def _interrupted(self, out: Path) -> Interrupted:
        """Say what there is in the folder, if it is that of this campaign, and how to go on."""
        table = None
        n_finished = 0
        with suppress(UvmsError):
            if read_manifest(out) == self.identity():
                table = read_table(out)
                n_finished = len(table)
        return Interrupted(
            f"stopped with {n_finished} of {self.runs} runs in {out}; the same call goes on with"
            " the rest",
            table,
        )

    def scenario_of(self, run: Count) -> Scenario:
        """Build the scenario of run `run`. Raises `InvalidInput` for one that there is not."""
        if not 0 <= run < self.runs:
            raise InvalidInput(
                f"run {run} of a campaign with {self.runs} runs; give a number from 0 to"
                f" {self.runs - 1}"
            )
        return self.work.scenario_of(run)

    def identity(self) -> CampaignManifest:
        """Return the manifest by which the folder recognises the campaign."""
        values = built(self.work.variations)
        return CampaignManifest(
            name=_title(self.work.scenario),
            package=__version__,
            parameters={variation.name: str(variation).partition(": ")[2] for variation in values},
            columns=types_of(self.work),
            scenario=_identity(self.work.scenario),
            variations=_identity(self.work.variations),
            **{name: getattr(self, name) for name in _PLAIN_FIELDS},
        )

    def sources(self) -> dict[str, bytes]:
        """Return the files to keep a copy of, by the name that the copy has."""
        parts = {"scenario": self.work.scenario, "variations": self.work.variations}
        contents = {}
        for part, source in parts.items():
            if isinstance(source, CodeSource):
                for name, content in source.files.items():
                    contents[f"{part}/{name}"] = content
        return contents


def kept_campaign(folder: Path) -> Campaign:
    """Return the campaign of a folder, made of the copies that it keeps: whatever has become of the
    files since.

    Raises `InvalidInput` where there is none, where a copy was changed, and for one whose scenario
    is a function of Python, which is not kept.
    """
    manifest = read_manifest(folder)
    variations: Any = manifest.variations
    has_lost_scenario = "words" not in manifest.scenario
    if has_lost_scenario or variations.get("values", ()):
        if has_lost_scenario:
            lost_part = "scenario was a function in Python, which is"
        else:
            lost_part = "variations were values in Python, which are"
        raise InvalidInput(f"{folder}: its {lost_part} not kept; use Campaign.scenario_of there")
    restored_variations: CodeSource | tuple[()] = ()
    if "words" in variations:
        restored_variations = CodeSource.restored(variations, folder / SOURCES / "variations")
    campaign = Campaign(
        scenario=CodeSource.restored(manifest.scenario, folder / SOURCES / "scenario"),
        variations=restored_variations,
        **{name: getattr(manifest, name) for name in _PLAIN_FIELDS},
    )
    if campaign.identity().parameters != manifest.parameters:
        raise InvalidInput(
            f"{folder}: its parameters are not those of its variations; put back what was"
        )
    return campaign


def _gathered(source: Any, options: Mapping[str, Any], attribute: str) -> Any:
    if isinstance(source, str):
        return CodeSource.gathered(source, options, attribute)
    return source


def _identity(source: Any) -> dict[str, Any]:
    if isinstance(source, CodeSource):
        return source.identity()
    if callable(source):
        # By the source of the function, so that a folder is not continued by other code of the
        # same name; where there is none, as of code that was typed in, by its kind alone.
        try:
            text = inspect.getsource(source)
        except (OSError, TypeError):
            text = repr(type(source))
        return {"function": _title(source), "sha256": hashlib.sha256(text.encode()).hexdigest()}
    return {"values": [str(value) for value in source]}


def _title(source: Any) -> str:
    if isinstance(source, CodeSource):
        return Path(source.words).name
    return str(getattr(source, "__qualname__", type(source).__name__))
