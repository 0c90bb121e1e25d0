"""The time series of one run: filled row by row, then frozen, saved and loaded without pickle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
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
    """Collects rows of equal structure in blocks of memory, series of one type side by side."""

    def __init__(self, capacity: int = 1024) -> None:
        """capacity [-]: rows of a block."""
        self._capacity = capacity
        self._n = 0
        self._width = 0
        self._groups: list[_Group] = []
        self._of: dict[str, _Group] = {}

    def append(self, row: Mapping[str, Any]) -> None:
        """Add one row. Raises `InvalidInput` for one with other series than the first; a shape must fit that of the first."""
        if not self._groups:
            self._begin(row)
        if len(row) != self._width:
            raise self._other(row)
        block, place = divmod(self._n, self._capacity)
        try:
            for group in self._groups:
                group.put(row, block, place)
        except KeyError:
            raise self._other(row) from None
        self._n += 1

    def __contains__(self, name: str) -> bool:
        """Whether there is a series of that name."""
        return name in self._of

    def last(self, name: str) -> Any:
        """The newest value of the series `name`."""
        return self.at(name, -1)

    def at(self, name: str, row: int) -> Any:
        """The value of the series `name` in a row."""
        index = range(self._n)[row]
        return self._of[name].part(name, index // self._capacity)[index % self._capacity]

    def freeze(self, meta: RunMeta | PlanMeta) -> Record:
        """The rows so far as a `Record`."""
        return Record(series=self.series(), meta=meta)

    def series(self) -> dict[str, np.ndarray]:
        """The rows so far by name, (n, ...) each: copies."""
        return {name: group.rows(name, self._n) for name, group in self._of.items()}

    def _other(self, row: Mapping[str, Any]) -> InvalidInput:
        return InvalidInput(f"row of {', '.join(row)}; give {', '.join(self._of)}, as in the first one")

    def _begin(self, row: Mapping[str, Any]) -> None:
        kinds: dict[Any, dict[str, np.ndarray]] = {}
        for name, value in row.items():
            sample = np.asarray(value)
            own = name if sample.ndim > 1 else ""
            kinds.setdefault((sample.dtype, min(sample.ndim, 2), own), {})[name] = sample
        self._groups = [_Group(samples, self._capacity) for samples in kinds.values()]
        found = {name: group for group in self._groups for name in group.names}
        self._of, self._width = {name: found[name] for name in row}, len(row)


class _Group:
    """Numbers, or columns, of one type: one row of memory takes all of them at once. A table is a group by itself."""

    def __init__(self, samples: Mapping[str, np.ndarray], capacity: int) -> None:
        ndim = next(iter(samples.values())).ndim
        self.names = tuple(samples)
        self._pick = itemgetter(*samples)
        self._sizes = [sample.size for sample in samples.values()]
        ends = np.cumsum(self._sizes).tolist()
        places = [slice(end - size, end) if ndim else end - 1 for end, size in zip(ends, self._sizes, strict=True)]
        self._places: dict[str, Any] = dict(zip(samples, places, strict=True))
        self._joined = ndim == 1 and len(samples) > 1
        self._shape: tuple[int, ...] = (capacity, ends[-1])
        if ndim > 1:
            ((name, table),) = samples.items()
            self._shape, self._places = (capacity, *table.shape), {name: ...}
        self._dtype = next(iter(samples.values())).dtype
        self._blocks: list[np.ndarray] = []

    def put(self, row: Mapping[str, Any], block: int, place: int) -> None:
        """Into a place of a block, the newest or a new one."""
        if block == len(self._blocks):
            self._blocks.append(np.empty(self._shape, dtype=self._dtype))
        values, memory = self._pick(row), self._blocks[block]
        if self._joined:
            np.concatenate(self._fitted(values), out=memory[place], casting="unsafe")
        else:
            memory[place] = values

    def part(self, name: str, block: int) -> np.ndarray:
        """Of a block, the rows of one series."""
        return self._blocks[block][:, self._places[name]]

    def _fitted(self, values: Sequence[Any]) -> Sequence[Any]:
        try:
            if [*map(len, values)] == self._sizes:
                return values
        except TypeError:  # a number, which stands for all
            pass
        return [np.broadcast_to(value, size) for value, size in zip(values, self._sizes, strict=True)]

    def rows(self, name: str, n: int) -> np.ndarray:
        """The first n rows of one series: a copy."""
        return np.concatenate([self.part(name, k) for k in range(len(self._blocks))])[:n]
