"""What a campaign is, written down beside its rows: another one, or a changed one, is refused."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

from uvms_ocp.campaign.runs.work import Work, columns_of
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.output.durable import write_durably
from uvms_ocp.output.manifest import STORE, read_as

FILE, SOURCES = "campaign.json", "sources"
_KINDS: Mapping[str, type] = {"int": int, "float": float, "str": str, "bool": bool}


class Identity(BaseModel):
    """The file `campaign.json`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    version: Literal[1] = 1
    """Of this file and of the table."""
    name: str
    """As it was asked for."""
    package: str
    """Version of uvms_ocp."""
    runs: int
    """[-]"""
    seed: int
    """[-]"""
    sampler: str
    """Of `uvms_ocp.campaign.variations.samplers.SAMPLERS`."""
    parameters: dict[str, str]
    """Distributions by name."""
    columns: dict[str, str]
    """Types by name."""
    scenario: dict[str, Any]
    """Where it comes from, with the hash of every file."""
    variations: dict[str, Any]
    """Where they come from."""
    records: str
    """Which runs keep theirs."""

    @property
    def types(self) -> dict[str, type]:
        """Of the columns."""
        return {name: _KINDS[kind] for name, kind in self.columns.items()}


def types_of(work: Work) -> dict[str, str]:
    """Of the columns of its table, by name, as `Identity` has them."""
    return {name: kind.__name__ for name, kind in columns_of(work).items()}


def read_identity(folder: Path) -> Identity:
    """Of the campaign in a folder. Raises `InvalidInput` where there is none, or one that is damaged."""
    found = read_as(Identity, folder / FILE)
    if found is None:
        raise InvalidInput(f"{folder}: no campaign is there; give the folder of one, or a mission with --out")
    return found


def claim_identity(folder: Path, wanted: Identity) -> None:
    """Write down what a new campaign is.

    Raises `InvalidInput`, naming what differs, for another campaign, and for a folder of something else.
    """
    known = read_as(Identity, folder / FILE)
    if known is None:
        if others := [path.name for path in folder.iterdir() if path.name != STORE]:
            raise InvalidInput(f"{folder}: holds {others[0]} and no campaign; give a folder that is empty or new")
        write_durably(folder / FILE, json.dumps(wanted.model_dump(), indent=1) + "\n")
    elif differs := list(_differences("", known.model_dump(), json.loads(wanted.model_dump_json()))):
        advice = "take the folder of a new campaign, or put back what was"
        raise InvalidInput(f"{folder}: another campaign is there; not the same: {differs[0]}; {advice}")


def _differences(place: str, known: Any, wanted: Any) -> Any:
    if isinstance(known, dict) and isinstance(wanted, dict):
        for name in [*known, *(name for name in wanted if name not in known)]:
            yield from _differences(f"{place}{' ' if place else ''}{name}", known.get(name), wanted.get(name))
    elif known != wanted:
        yield f"{place} ({_short(known)}, now {_short(wanted)})"


def _short(value: Any) -> str:
    text = "none" if value is None else str(value)
    return text if len(text) <= 40 else text[:39] + "…"
