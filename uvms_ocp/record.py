"""The time series of one run: filled row by row, then frozen, saved and loaded without pickle."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from uvms_ocp.arguments import checked, late
from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.run_meta import PlanMeta, RunMeta, read_meta, write_meta

_META_KEY = "__meta__"


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Record:
    """Named time series that share their first axis, and what is needed to read them.

    Plots and reports read nothing else. Raises `InvalidInput` for metadata of any other type.
    """

    series: Mapping[str, np.ndarray]
    """By name, read-only, (n, ...) each; ``t`` (n,) [s] is always there."""
    meta: RunMeta | PlanMeta

    def __post_init__(self) -> None:
        if not isinstance(self.meta, (RunMeta, PlanMeta)):
            raise InvalidInput(f"meta = {type(self.meta).__name__}; give a RunMeta or a PlanMeta")
        for array in self.series.values():
            array.flags.writeable = False

    def __len__(self) -> int:
        return len(self.series["t"])

    @late
    def __getitem__(self, name: str) -> np.ndarray:
        """The series `name` (n, ...); raises `NameNotFound` with the names there are."""
        if name not in self.series:
            raise NameNotFound("series", name, sorted(self.series))
        return self.series[name]

    @property
    def run_meta(self) -> RunMeta:
        """`meta` of a run. Raises `InvalidInput` for a plan."""
        if self.meta.kind != "run":
            raise InvalidInput(f"this record is of a plan ({self.meta.scenario}); give that of a run")
        return self.meta

    @property
    def plan_meta(self) -> PlanMeta:
        """`meta` of a plan. Raises `InvalidInput` for a run."""
        if self.meta.kind != "plan":
            raise InvalidInput(f"this record is of a run ({self.meta.scenario}); give that of a plan")
        return self.meta

    def save(self, path: Path | str) -> None:
        """Write one ``.npz`` file; arrays stay arrays, `meta` becomes a JSON string."""
        text = np.array(write_meta(self.meta))
        with Path(path).open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **{_META_KEY: text}, **self.series)

    @staticmethod
    def load(path: Path | str) -> Record:
        """Read a file written by `save`, of this version or of 0.1; raises `InvalidInput`, in one line, where it is not one."""
        try:
            with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as data:
                series = {name: data[name] for name in data.files if name != _META_KEY}
                text = str(data[_META_KEY])
        except (OSError, ValueError, KeyError, EOFError, BadZipFile, zlib.error) as error:
            raise InvalidInput(f"{path}: not a record written by uvms_ocp ({error})") from error
        if "t" not in series:
            raise InvalidInput(f"{path}: not a record written by uvms_ocp (no series 't')")
        try:
            return Record(series=series, meta=read_meta(text))
        except InvalidInput as error:
            raise InvalidInput(f"{path}: {error}") from error


@checked
def quantity(record: Record, name: str) -> np.ndarray | None:
    """The series (n,) of a measured quantity such as ``T.position_error``; `None` where no task measures it."""
    names = record.meta.quantities
    return record["quantities"][:, names.index(name)] if name in names else None


class Recorder:
    """Collects rows of equal structure into arrays that double when full."""

    def __init__(self, capacity: int = 1024) -> None:
        self._capacity = capacity
        self._n = 0
        self._arrays: dict[str, np.ndarray] = {}

    def append(self, row: Mapping[str, Any]) -> None:
        """Add one row; every row has the keys and shapes of the first."""
        if not self._arrays:
            self._arrays = {name: self._allocate(value) for name, value in row.items()}
        if self._n == self._capacity:
            self._grow()
        for name, value in row.items():
            self._arrays[name][self._n] = value
        self._n += 1

    def last(self, name: str) -> Any:
        """The newest value of the series `name`."""
        return self._arrays[name][self._n - 1]

    def at(self, name: str, row: int) -> Any:
        """The value of the series `name` in a row."""
        return self._arrays[name][: self._n][row]

    def freeze(self, meta: RunMeta | PlanMeta) -> Record:
        """The rows so far as a `Record`."""
        return Record(series=self.series(), meta=meta)

    def series(self) -> dict[str, np.ndarray]:
        """The rows so far by name, (n, ...) each: copies."""
        return {name: array[: self._n].copy() for name, array in self._arrays.items()}

    def _allocate(self, value: Any) -> np.ndarray:
        sample = np.asarray(value)
        return np.empty((self._capacity, *sample.shape), dtype=sample.dtype)

    def _grow(self) -> None:
        self._capacity *= 2
        for name, array in self._arrays.items():
            self._arrays[name] = np.resize(array, (self._capacity, *array.shape[1:]))
