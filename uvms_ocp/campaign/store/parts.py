"""A Parquet data set in parts: each is written once, whole or not at all, and a run is finished when its part is there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from uvms_ocp.campaign.store.whole_file import whole_file
from uvms_ocp.exceptions import InvalidInput, NotInstalled
from uvms_ocp.output.durable import discard, sync_folders

FOLDER = "rows"
_MANY = 200  # parts, before they are joined
_GROUP = 10_000  # rows of a group in a file


def arrow() -> Any:
    """The library pyarrow. Raises `NotInstalled` without it."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise NotInstalled("a campaign", '"uvms-ocp[campaign]"') from None
    return pyarrow


class Parts:
    """Those of one campaign; for one process at a time."""

    def __init__(self, folder: Path, columns: Mapping[str, type]) -> None:
        """folder: of the campaign. columns: of its table, by name."""
        self._folder, self._columns = folder / FOLDER, dict(columns)
        self._folder.mkdir(parents=True, exist_ok=True)
        for left in self._folder.glob("*.tmp"):
            discard(left)
        names = self.paths()
        self._next = 1 + max((int(path.stem.rpartition("-")[2]) for path in names), default=-1)
        self._n = len(names)

    def paths(self) -> list[Path]:
        """All files, the oldest first."""
        return part_paths(self._folder.parent)

    def append(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Write rows to the disk, so that they survive a loss of power. Raises `OutputError` where the disk refuses."""
        if rows:
            pa = arrow()
            self._write(pa.Table.from_pylist([dict(row) for row in rows], schema=schema_of(self._columns)))
            if self._n >= _MANY:
                self.join()

    def join(self) -> None:
        """One file in place of many. Cut off, some rows are there twice, which readers know. Raises `OutputError`."""
        paths = self.paths()
        if len(paths) > 1:
            self._write(read_rows(self._folder.parent, self._columns))
            for path in paths:
                path.unlink()
            self._n = 1
            sync_folders([self._folder])

    def _write(self, table: Any) -> None:
        pa = arrow()
        path = self._folder / f"part-{self._next:08d}.parquet"
        with whole_file(path) as file:
            pa.parquet.write_table(table, file, row_group_size=_GROUP)
        self._next, self._n = self._next + 1, self._n + 1


def part_paths(folder: Path) -> list[Path]:
    """Files of the data set of a campaign, the oldest first."""
    return sorted((folder / FOLDER).glob("part-*.parquet"))


def read_rows(folder: Path, columns: Mapping[str, type], wanted: Sequence[str] | None = None) -> Any:
    """A pyarrow table of all finished runs, by run number, each once. wanted: columns, all by default.

    Raises `InvalidInput` for a file that is damaged.
    """
    pa = arrow()
    names = list(columns) if wanted is None else list(wanted)
    tables = [_read(path, names) for path in part_paths(folder)]
    if not tables:
        return schema_of({name: columns[name] for name in names}).empty_table()
    table = pa.concat_tables(tables)
    return table.take(_first_of_each(table["run"].to_numpy()))


def _read(path: Path, names: Sequence[str]) -> Any:
    pa = arrow()
    try:
        return pa.parquet.read_table(path, columns=list(names), partitioning=None)
    except (OSError, pa.ArrowException) as error:
        reason = " ".join(str(error).split())[:200]
        raise InvalidInput(f"{path}: damaged ({reason}); move it away, its runs are made again") from None


def _first_of_each(runs: Any) -> Any:
    import numpy as np

    return np.unique(runs, return_index=True)[1]


def schema_of(columns: Mapping[str, type]) -> Any:
    """Of the table, as pyarrow has it."""
    pa = arrow()
    kinds = {int: pa.int64(), float: pa.float64(), str: pa.string(), bool: pa.bool_()}
    return pa.schema([(name, kinds[kind]) for name, kind in columns.items()])
