"""Record the rows of a run tick by tick, in memory or in files, until they are frozen to a
`Record`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from io import BytesIO
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.errors import InvalidInput, OutputError
from uvms_ocp.record import durable_files, output, row_rates
from uvms_ocp.record.record import Record
from uvms_ocp.record.row_files import META, append_rows, read_row_files
from uvms_ocp.record.run_meta import PlanMeta, RunMeta, write_meta


class Recorder:
    """Collects rows of equal structure in a block of memory, and from there, series by series, in
    memory or in files.
    """

    def __init__(
        self,
        capacity: int = 512,
        folder: Path | None = None,
        news: Callable[[], RunMeta | PlanMeta | None] = lambda: None,
        every: int = 1,
    ) -> None:
        """capacity: rows of the block. folder: a new one, for the files; raises `OutputError` for
        one that is there.

        news: gives the metadata that the folder has beside them, `None` where they are as before.
        every: of how many rows that are appended one is kept, as by `thinned_rows`; the first of
        all, and the last of all and of each phase are.
        """
        self._capacity = -(-capacity // every) * every
        self._folder = folder
        self._news = news
        self._every = every
        if folder is not None and folder.exists():
            raise OutputError(f"{folder} is there already; give a folder that is not there yet")
        self._n = 0
        """Number of rows that were added."""
        self._kept = 0
        """Number of added rows that have left the block."""
        self._written = 0
        """Number of added rows that stay, in memory or in files."""
        self._block: dict[str, np.ndarray] = {}
        """(capacity, ...) [as the series] rows of every series that are not yet kept."""
        self._pick: Callable[[Mapping[str, Any]], tuple[Any, ...]] = lambda row: ()
        """Function that returns the values of a row in the order of the block."""
        self._memory: dict[str, tuple[np.ndarray, BytesIO]] = {}
        """An empty array of the kind of each series, and the bytes of its rows."""

    def append(self, row: Mapping[str, Any]) -> None:
        """Add one row.

        Raises `InvalidInput` for one with other series than the first, and `OutputError` where the
        disk refuses; shapes must fit those of the first.
        """
        if not self._block:
            self._begin(row)
        try:
            values = self._pick(row)
        except KeyError:
            values = ()
        if len(values) != len(row):
            raise InvalidInput(
                f"row of {', '.join(row)}; give {', '.join(self._block)}, as in the first one"
            )
        for memory, value in zip(self._block.values(), values, strict=True):
            memory[self.place] = value
        self.filled(1)

    def block(self, row: Mapping[str, Any]) -> Mapping[str, np.ndarray]:
        """Return memory (capacity, ...) of series, for rows such as this, to be written to from
        `place` on.
        """
        if not self._block:
            self._begin(row)
        return self._block

    @property
    def place(self) -> int:
        """Number of the next row in the block."""
        return self._n - self._kept

    @property
    def room(self) -> int:
        """Rows that may be written there before they are `filled` in."""
        if self._n == 0 and self._every > 1:
            return 1
        return self._capacity - self.place

    def filled(self, n: int) -> None:
        """Add so many rows, at most `room`, that were written into the block."""
        is_first = self._n == 0 and n > 0
        self._n = self._n + n
        # Rows end spans of ticks, the first its own.
        ends_first_span = is_first and self._every > 1
        if self.place == self._capacity or ends_first_span:
            self._keep()

    def __contains__(self, name: str) -> bool:
        """Return whether there is a series of that name."""
        return name in self._block

    def last(self, name: str) -> Any:
        """Return the newest value of the series `name`."""
        return np.array(self.series()[name][-1])[()]

    def freeze(self, meta: RunMeta | PlanMeta) -> Record:
        """Return the rows so far as a `Record`."""
        self._news = lambda: meta
        return Record(series=self.series(), meta=meta)

    def series(self) -> dict[str, np.ndarray]:
        """Return the rows so far by name, read-only, (n, ...) each; those in files are mapped."""
        self._keep()
        if self._folder:
            return read_row_files(self._folder)
        series = dict[str, np.ndarray]()
        for name, (kind, memory) in self._memory.items():
            numbers = np.frombuffer(memory.getvalue(), kind.dtype)
            series[name] = numbers.reshape(self._written, *kind.shape[1:])
        return series

    def _keep(self) -> None:
        """Bring the rows of the block to where they stay, and then the metadata that are new."""
        rows = self._rows_to_keep()
        if self._folder:
            self._write(self._folder, rows)
        else:
            for name, part in rows.items():
                if name not in self._memory:
                    self._memory[name] = (part[:0].copy(), BytesIO())
                _, memory = self._memory[name]
                memory.write(np.ascontiguousarray(part).data)
        self._kept = self._n
        self._written = self._written + len(next(iter(rows.values()), ()))

    def _rows_to_keep(self) -> dict[str, np.ndarray]:
        """Return the rows of the block by series, thinned where not every one is kept."""
        n = self._n - self._kept
        if n == 0:
            return {}
        rows = {name: memory[:n] for name, memory in self._block.items()}
        if self._every == 1:
            return rows
        regular_rows = np.flatnonzero(np.arange(self._kept, self._n) % self._every == 0)
        phase_ends = np.flatnonzero(np.diff(rows.get("phase", np.zeros(n))))
        return row_rates.thinned_rows(rows, np.unique([*regular_rows, *phase_ends, n - 1]))

    def _write(self, folder: Path, rows: Mapping[str, np.ndarray]) -> None:
        """Append rows to the files, and replace the metadata where they are new."""
        with output.as_output_errors(folder, "make room; what was written before can be read"):
            folder.mkdir(parents=True, exist_ok=self._kept > 0)
            append_rows(folder, rows, self._written)
            meta = self._news()
            if meta is not None:
                durable_files.write_durably(folder / META, write_meta(meta))

    def _begin(self, row: Mapping[str, Any]) -> None:
        """Make the block, for rows of the series, shapes and types of this one."""
        self._block = {}
        for name, value in row.items():
            kind = np.asarray(value)
            self._block[name] = np.empty((self._capacity, *kind.shape), kind.dtype)
        # A getter of one name would give its value in place of a tuple.
        if len(row) > 1:
            self._pick = itemgetter(*row)
        else:
            name = next(iter(row))
            self._pick = lambda row: (row[name],)
