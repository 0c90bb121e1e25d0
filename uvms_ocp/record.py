"""The time series of one run: filled row by row, then frozen, saved and loaded without pickle."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.arguments import checked, late
from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.record_checks import check_series
from uvms_ocp.run_meta import PlanMeta, RunMeta, read_meta, write_meta
from uvms_ocp.shown.small_table import SmallTable, Tabled
from uvms_ocp.tables import record_files
from uvms_ocp.tables.mcap import mcap_file
from uvms_ocp.tables.series_table import meaning_of, unit_of
from uvms_ocp.untrusted.array_file import read_arrays
from uvms_ocp.validation import shown

_META_KEY = "__meta__"
# From 4 MB on NumPy asks for large pages, whose first touch takes a fraction of the time.
_BLOCK = 8 * 2**20  # [bytes]


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Record(Tabled):
    """Named time series that share their first axis, and what is needed to read them.

    Plots and reports read nothing else. Raises `InvalidInput` for metadata of any other type.
    """

    series: Mapping[str, np.ndarray]
    """By name, read-only, (n, ...) each; ``t`` (n,) [s] is always there."""
    meta: RunMeta | PlanMeta

    def __len__(self) -> int:
        return len(self.series["t"])

    def _table(self) -> SmallTable:
        t, meta = self.series["t"], self.meta
        span = f"{t[0]:g} to {t[-1]:g} s" if len(t) else "no time"
        return SmallTable(
            title=f"Record of a {meta.kind}, {meta.scenario}, {meta.robot}: {len(t)} rows, {span}",
            head=("series", "shape", "unit", "meaning"),
            rows=tuple(
                (name, str(array.shape), unit_of(name), meaning_of(name)) for name, array in self.series.items()
            ),
        )

    @late
    def __getitem__(self, name: str) -> np.ndarray:
        """The series `name` (n, ...), or that of a measured quantity such as ``T.position_error``.

        Raises `NameNotFound` with the names there are.
        """
        if name in self.series:
            return self.series[name]
        if name in self.meta.quantities and "quantities" in self.series:
            return self.series["quantities"][:, self.meta.quantities.index(name)]
        raise NameNotFound("series", name, [*sorted(self.series), *self.meta.quantities])

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

    def to_dataframe(self) -> Any:
        """A pandas.DataFrame, one row per tick; `uvms_ocp.tables.series_table.SERIES` says what the columns are.

        Raises `NotInstalled` without pandas, as do the files below.
        """
        return record_files.to_dataframe(self.series, self.meta)

    def to_csv(self, path: Path | str) -> None:
        """Write the table of `to_dataframe`, every number in full. Raises `OutputError`, `NotInstalled`."""
        record_files.to_csv(self.series, self.meta, Path(path))

    def to_parquet(self, path: Path | str) -> None:
        """Write a file that `from_parquet` reads as the same record. Raises `OutputError`, `NotInstalled`."""
        record_files.to_parquet(self.series, self.meta, Path(path))

    @staticmethod
    def from_parquet(path: Path | str) -> Record:
        """Read a file of `to_parquet`. Raises `InvalidInput` for another or a damaged one, and `NotInstalled`."""
        return _fitting(*record_files.from_parquet(Path(path)))

    def to_mcap(self, path: Path | str) -> None:
        """Write a file that Foxglove opens, and `from_mcap` as the same record. Raises `OutputError`, `NotInstalled`.

        ``/tf`` has the poses of vehicle, its estimate and tool, ``/goals`` those of goals, ``/joint_states`` what a URDF layer
        moves by, ``/wrench`` and others the forces, ``/log`` phases, alarms and faults, ``/series/...`` every series.
        """
        mcap_file.to_mcap(self.series, self.meta, Path(path))

    @staticmethod
    def from_mcap(path: Path | str) -> Record:
        """Read a file of `to_mcap`. Raises `InvalidInput` for another or a damaged one, and `NotInstalled`."""
        return _fitting(*mcap_file.from_mcap(Path(path)))

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


def _fitting(series: Mapping[str, np.ndarray], meta: RunMeta | PlanMeta) -> Record:
    """The record of an exported file. Raises `InvalidInput` for series that do not fit each other or the metadata."""
    check_series(series, meta)
    return Record(series=series, meta=meta)


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
    """Collects rows of equal structure in blocks of memory, which stay where they are."""

    def __init__(self, capacity: int = 0) -> None:
        """capacity [-]: rows of a block; 0 for as many as the memory asked for at a time holds."""
        self._capacity = capacity
        self._n = 0
        self._names: tuple[str, ...] = ()
        self._row = np.dtype([])
        self._pick: Callable[[Mapping[str, Any]], tuple[Any, ...]] = lambda row: ()
        self._blocks: list[list[np.ndarray]] = []
        """Of each, one view (capacity, ...) for every series: a row lies in one place, on one page or two."""

    def append(self, row: Mapping[str, Any]) -> None:
        """Add one row. Raises `InvalidInput` for one with other series than the first; shapes must fit those of the first."""
        if not self._names:
            self._begin(row)
        if len(row) != len(self._names):
            raise self._other(row)
        try:
            values = self._pick(row)
        except KeyError:
            raise self._other(row) from None
        place = self._n % self._capacity
        if place == 0:
            block = np.empty(self._capacity, self._row)
            self._blocks.append([block[name] for name in self._row.names or ()])
        for memory, value in zip(self._blocks[-1], values, strict=True):
            memory[place] = value
        self._n += 1

    def __contains__(self, name: str) -> bool:
        """Whether there is a series of that name."""
        return name in self._names

    def last(self, name: str) -> Any:
        """The newest value of the series `name`."""
        return self.at(name, -1)

    def at(self, name: str, row: int) -> Any:
        """The value of the series `name` in a row."""
        block, place = divmod(range(self._n)[row], self._capacity)
        return self._blocks[block][self._names.index(name)][place]

    def freeze(self, meta: RunMeta | PlanMeta) -> Record:
        """The rows so far as a `Record`."""
        return Record(series=self.series(), meta=meta)

    def series(self) -> dict[str, np.ndarray]:
        """The rows so far by name, (n, ...) each: copies."""
        return {
            name: np.concatenate([block[k] for block in self._blocks])[: self._n] for k, name in enumerate(self._names)
        }

    def _begin(self, row: Mapping[str, Any]) -> None:
        names = tuple(row)
        samples = enumerate(map(np.asarray, row.values()))
        self._row = np.dtype([(f"series{k}", sample.dtype, sample.shape) for k, sample in samples], align=True)
        self._capacity = self._capacity or max(1, _BLOCK // max(1, self._row.itemsize))
        # A getter of one name would give its value in place of a tuple.
        self._pick = itemgetter(*names) if len(names) > 1 else lambda row: (row[names[0]],)
        self._names = names

    def _other(self, row: Mapping[str, Any]) -> InvalidInput:
        return InvalidInput(f"row of {', '.join(row)}; give {', '.join(self._names)}, as in the first one")
