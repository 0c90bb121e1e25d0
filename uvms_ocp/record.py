"""The time series of one run: filled row by row, then frozen, saved and loaded without pickle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.arguments import checked, late
from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.run_meta import PlanMeta, RunMeta, read_meta, write_meta
from uvms_ocp.untrusted.array_file import read_arrays
from uvms_ocp.validation import shown

_META_KEY = "__meta__"
_AXES = ("x", "x_rate", "x_acceleration", "x_jerk", "x_snap")
_FINITE = ("q", "v", "command", *_AXES)


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
            _check_series(record)
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


def _check_series(record: Record) -> None:
    """Raise `InvalidInput` where the series of a file are not what `Record` promises."""
    series = record.series
    if "t" not in series:
        raise InvalidInput("no series 't'")
    t = series["t"]
    if t.dtype.kind != "f" or t.ndim != 1 or not t.size or not np.isfinite(t).all() or (np.diff(t) <= 0.0).any():
        raise InvalidInput(
            f"times t of shape {t.shape}; allowed: one or more [s], finite, each later than the one before"
        )
    for name, array in series.items():
        if array.ndim not in (1, 2) or len(array) != len(t) or array.dtype.kind == "U":
            raise InvalidInput(
                f"series {name!r} is {array.dtype} of shape {array.shape}; allowed: numbers for {len(t)} times"
            )
        if name in _FINITE and not np.isfinite(array).all():
            raise InvalidInput(
                f"series {name!r} has NaN or infinity at t = {_first_wrong(t, array):g} s; record it anew"
            )
    _check_widths(record)
    _check_numbers(record)
    for event in record.meta.events if isinstance(record.meta, RunMeta) else ():
        if not t[0] <= event.t <= t[-1]:
            raise InvalidInput(f"an event at {event.t:g} s; allowed: {t[0]:g} to {t[-1]:g} s, the times of the record")


def _first_wrong(t: np.ndarray, array: np.ndarray) -> float:
    return float(t[np.argmin(np.isfinite(array).reshape(len(t), -1).all(axis=1))])


def _check_widths(record: Record) -> None:
    meta, joints = record.meta, len(record.meta.joints)
    rows = sum(level.rows for level in meta.levels)
    wanted = {"gates": len(meta.tasks), "activity": rows, "residual": rows, "quantities": len(meta.quantities)}
    if isinstance(meta, PlanMeta):
        wanted |= {name: len(meta.axes) for name in _AXES} | {"clearance": len(meta.clearance_groups)}
    if meta.limits is not None:
        wanted |= {"v": len(meta.limits.velocity), "torque": len(meta.limits.effort)}
    for name in sorted(record.series.keys() & {*wanted, "q", "v"}):
        shape = record[name].shape
        width = wanted.get(name)
        if len(shape) != 2 or (width is not None and shape[1] != width) or (name in ("q", "v") and shape[1] < joints):
            columns = f"{joints} or more" if width is None else width
            raise InvalidInput(f"series {name!r} has shape {shape}; its metadata allow {shape[0]} rows of {columns}")


def _check_numbers(record: Record) -> None:
    meta = record.meta
    counted = {"phase": len(meta.phases)} | ({"status": len(meta.statuses)} if isinstance(meta, RunMeta) else {})
    for name, n in counted.items():
        if n and name in record.series:
            values = record[name]
            if values.dtype.kind not in "iu" or values.ndim != 1 or values.min() < 0 or values.max() >= n:
                raise InvalidInput(
                    f"series {name!r} counts what the metadata do not have; allowed: whole numbers below {n}"
                )


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
