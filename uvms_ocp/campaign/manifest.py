"""Manifest of a campaign, a file beside its rows that describes it, so that a folder with rows of
another campaign, or of a changed one, is refused.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, TypeAlias

from pydantic import Field, model_validator

from uvms_ocp.campaign.jobs import FIRST, LAST, CampaignJob, columns_of
from uvms_ocp.campaign.sampling_design import GROWING, Design
from uvms_ocp.errors import InvalidInput, UvmsError, plain_line
from uvms_ocp.model_errors import FileModel
from uvms_ocp.record import durable_files
from uvms_ocp.record.manifest import STORE, read_as

FILE = "campaign.json"
"""Name of the manifest in the folder of a campaign."""
SOURCES = "sources"
"""Name of the folder in that of a campaign with copies of code and robots."""
MOST_RUNS = 10_000_000
"""Largest number of runs of a campaign."""
Kind: TypeAlias = Literal["int", "float", "str", "bool"]
_KINDS: Mapping[Kind, type] = {"int": int, "float": float, "str": str, "bool": bool}


class CampaignManifest(FileModel, strict=True):
    """Values of the file `campaign.json`: what a campaign is, and its columns."""

    version: Literal[1] = 1
    """Version of this file and of the table."""
    name: str
    package: str
    """Version of uvms_ocp."""
    runs: int = Field(ge=1, le=MOST_RUNS)
    seed: int = Field(ge=0)
    sampler: str
    """One of `uvms_ocp.campaign.sampling_design.SAMPLERS`."""
    parameters: dict[str, str]
    """Distributions of the parameters, by name, in words."""
    columns: dict[str, Kind]
    """Types of the columns of its table, by name."""
    scenario: dict[str, Any]
    """Source of the scenario, with the hash of every file."""
    variations: dict[str, Any]
    """Source of the variations."""
    records: Literal["none", "failures", "all"]
    """Runs that keep their whole record."""

    @model_validator(mode="after")
    def _columns_are_those_of_a_campaign(self) -> CampaignManifest:
        needed = {**FIRST, **dict.fromkeys(self.parameters, float), **LAST}
        for name, kind in needed.items():
            if self.columns.get(name) != kind.__name__:
                raise ValueError(
                    f"columns have no {name!r} of kind {kind.__name__}; put back what was"
                )
        try:
            _ = self.design
        except UvmsError as error:
            raise ValueError(str(error)) from None
        return self

    @property
    def design(self) -> Design:
        """Design of the samples."""
        return Design(
            sampler=self.sampler, runs=self.runs, parameters=len(self.parameters), seed=self.seed
        )

    @property
    def types(self) -> dict[str, type]:
        """Types of the columns of its table, by name."""
        return {name: _KINDS[kind] for name, kind in self.columns.items()}


def types_of(work: CampaignJob) -> dict[str, Kind]:
    """Return the types of a job's columns by name, as in `CampaignManifest.columns`."""
    names: dict[type, Kind] = {kind: name for name, kind in _KINDS.items()}
    return {name: names[kind] for name, kind in columns_of(work).items()}


def read_manifest(folder: Path) -> CampaignManifest:
    """Read the manifest of the campaign in a folder. Raises `InvalidInput` where there is none, or
    a damaged one.
    """
    manifest = read_as(CampaignManifest, folder / FILE)
    if manifest is None:
        raise InvalidInput(
            f"{folder}: no campaign is there; give the folder of one, or a mission with --out"
        )
    return manifest


def claim_manifest(folder: Path, manifest: CampaignManifest) -> None:
    """Write the manifest of a new campaign, or the number of runs of one that grows.

    Raises `InvalidInput` for a folder with another campaign, with the first difference, or with
    anything else.
    """
    stored = read_as(CampaignManifest, folder / FILE)
    values = json.loads(manifest.model_dump_json())
    if stored is None:
        names = [path.name for path in folder.iterdir() if path.name != STORE]
        if names:
            raise InvalidInput(
                f"{folder}: holds {names[0]} and no campaign; give a folder that is empty or new"
            )
    else:
        expected = stored.model_dump()
        if stored.sampler in GROWING and manifest.runs > stored.runs:
            expected["runs"] = manifest.runs
        differences = list(_differences("", expected, values))
        if differences:
            raise InvalidInput(
                f"{folder}: another campaign is there; not the same: {differences[0]}; take the"
                " folder of a new campaign, or put back what was"
            )
    if stored is None or stored.runs != manifest.runs:
        durable_files.write_durably(folder / FILE, json.dumps(values, indent=1) + "\n")


def _differences(place: str, stored: Any, requested: Any) -> Iterator[str]:
    """Yield the differences of two values of a manifest; place: names that lead to them."""
    if isinstance(stored, dict) and isinstance(requested, dict):
        for name in stored | requested:
            name_place = f"{place} {name}" if place else name
            yield from _differences(name_place, stored.get(name), requested.get(name))
    elif stored != requested:
        yield f"{place} ({_short_text(stored)}, now {_short_text(requested)})"


def _short_text(value: Any) -> str:
    """Return a value in at most 40 characters."""
    return plain_line("none" if value is None else str(value), 40)
