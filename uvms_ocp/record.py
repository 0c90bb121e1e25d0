"""The time series of one run: filled row by row, then frozen, saved and loaded without pickle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.arguments import checked, late
from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.record_checks import check_series
from uvms_ocp.run_meta import PlanMeta, RunMeta, read_meta, write_meta
from uvms_ocp.untrusted.array_file import read_arrays
from uvms_ocp.validation import shown

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
        """Read a file written by `save`, of this version or of 0.1; it alone: `uvms_ocp.output.settle` looks after its folder.

        Raises `InvalidInput`, in one line, for what is no such file, is damaged or too large, and for series that do not fit
        each other, their times or the metadata.
        """
        try:
            arrays = dict(read_arrays(path))
            text = _text_of(arrays)
            record = Record(series=arrays, meta=read_meta(text))
            check_series(record.series, record.meta)
        except InvalidInput as error:
            raise InvalidInput(f"{shown(path)}: not a record written by uvms_ocp: {error}") from error
        return record


def _text_of(arrays: dict[str, np.ndarray]) -> str:
    """The metadata, taken out of the arrays."""
    if _META_KEY not in arrays:
        if {"breaks", "coefficients"} <= arrays.keys() or "summary" in arrays:
            raise InvalidInput("a plan's trajectory; give the record.npz beside it")
        raise InvalidInput(f"no series {_META_KEY!r}; give the record.npz that `run` or `plan` wrote")
    text = arrays.pop(_META_KEY)
    if text.dtype.kind != "U" or text.shape != ():
        raise InvalidInput(f"metadata of shape {text.shape} and type {text.dtype}; allowed: one text")
    return str(text)


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

    def __contains__(self, name: str) -> bool:
        """Whether there is a series of that name."""
        return name in self._arrays

    def last(self, name: str) -> Any:
        """The newest value of the series `name`."""
        return self._arrays[name][self._n - 1]

    def at(self, name: str, row: int) -> Any:
        """The value of the series `name` in a row."""
        return self._arrays[name][: self._n][row]

    def freeze(self, meta: RunMeta | PlanMeta) -> Record:
        """The rows so far as a `Record`."""
        return Record(series=self._rows(), meta=meta)  # which copies them

    def series(self) -> dict[str, np.ndarray]:
        """The rows so far by name, (n, ...) each: copies."""
        return {name: array.copy() for name, array in self._rows().items()}

    def _rows(self) -> dict[str, np.ndarray]:
        return {name: array[: self._n] for name, array in self._arrays.items()}

    def _allocate(self, value: Any) -> np.ndarray:
        sample = np.asarray(value)
        return np.empty((self._capacity, *sample.shape), dtype=sample.dtype)

    def _grow(self) -> None:
        self._capacity *= 2
        for name, array in self._arrays.items():
            self._arrays[name] = np.resize(array, (self._capacity, *array.shape[1:]))
