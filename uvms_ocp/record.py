"""The time series of one run: filled row by row, then frozen, saved and loaded without pickle."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.exceptions import InvalidInput, NameNotFound

_META_KEY = "__meta__"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Record:
    """Named time series that share their first axis, and what is needed to read them.

    ``series["t"]`` (n,) [s] is always there; ``meta`` holds JSON values only. Plots and reports read nothing else.
    """

    series: Mapping[str, np.ndarray]
    meta: Mapping[str, Any]

    def __post_init__(self) -> None:
        for array in self.series.values():
            array.flags.writeable = False

    def __len__(self) -> int:
        return len(self.series["t"])

    def __getitem__(self, name: str) -> np.ndarray:
        """The series `name` (n, ...); raises `NameNotFound` with the names there are."""
        if name not in self.series:
            raise NameNotFound("series", name, sorted(self.series))
        return self.series[name]

    def save(self, path: Path | str) -> None:
        """Write one ``.npz`` file; arrays stay arrays, ``meta`` becomes a JSON string."""
        text = np.array(json.dumps(dict(self.meta)))
        with Path(path).open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **{_META_KEY: text}, **self.series)

    @staticmethod
    def load(path: Path | str) -> Record:
        """Read a file written by `save`; raises `InvalidInput` where it is not one."""
        try:
            with np.load(path, allow_pickle=False) as data:
                series = {name: data[name] for name in data.files if name != _META_KEY}
                meta = json.loads(str(data[_META_KEY]))
        except (OSError, ValueError, KeyError) as error:
            raise InvalidInput(f"{path}: not a record written by uvms_ocp ({error})") from error
        return Record(series=series, meta=meta)


def quantity(record: Record, name: str) -> np.ndarray | None:
    """The series (n,) of a measured quantity such as ``T.position_error``; `None` where no task measures it."""
    names = record.meta.get("quantities", [])
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

    def freeze(self, meta: Mapping[str, Any]) -> Record:
        """The rows so far as a `Record`."""
        series = {name: array[: self._n].copy() for name, array in self._arrays.items()}
        return Record(series=series, meta=meta)

    def _allocate(self, value: Any) -> np.ndarray:
        sample = np.asarray(value)
        return np.empty((self._capacity, *sample.shape), dtype=sample.dtype)

    def _grow(self) -> None:
        self._capacity *= 2
        for name, array in self._arrays.items():
            self._arrays[name] = np.resize(array, (self._capacity, *array.shape[1:]))
