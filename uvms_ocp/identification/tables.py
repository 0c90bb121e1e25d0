"""Tables of numbers in files that anyone may have written, CSV and Parquet, and recordings stored as such."""

from __future__ import annotations

import csv
import gzip
import re
import zlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np

from uvms_ocp.errors import InvalidInput, NameNotFound, NotInstalled, UvmsError
from uvms_ocp.identification.recording import CHANNEL_KINDS, Channel, Recording
from uvms_ocp.record.tables import require_numbers
from uvms_ocp.record.untrusted import require_regular_file

# Columns of numbers in a file that anyone may have written: CSV, also packed by gzip, and Parquet.

MOST_ROWS = 5_000_000
"""of a file: 14 hours at 100 Hz."""
LONGEST_LINE = 1 << 20
"""characters: a packed file may have one that fills any memory."""
_COMMENT = "#"


def read_columns(path: Path, wanted: Sequence[str]) -> np.ndarray:
    """The wanted columns (n, k) [as they are] of a table; an empty cell is NaN.

    Raises NameNotFound for a column that there is not, NotInstalled, and InvalidInput for what is no table of numbers.
    """
    require_there(path)
    require_regular_file(path)
    return _from_parquet(path, wanted) if path.suffix == ".parquet" else _from_csv(path, wanted)


def column_names(path: Path) -> tuple[str, ...]:
    """Return the names of a table's columns. Raises InvalidInput for what is no table, and NotInstalled."""
    require_there(path)
    require_regular_file(path)
    if path.suffix == ".parquet":
        with _parquet(path) as file:
            return tuple(file.schema_arrow.names)
    with _opened(path) as file:
        return tuple(name.strip() for name in next(csv.reader(_rows_of(file)), []))


def require_there(path: Path) -> None:
    """Raises InvalidInput for a path where nothing is."""
    if not path.exists():
        raise InvalidInput(f"{path}: there is no such file")


def _from_csv(path: Path, wanted: Sequence[str]) -> np.ndarray:
    with _opened(path) as file:
        rows = csv.reader(_rows_of(file))
        places = _places(path, next(rows, []), wanted)
        return np.fromiter(_numbers(rows, places), dtype=float).reshape(-1, len(wanted))


@contextmanager
def _opened(path: Path) -> Iterator[IO[str]]:
    """A file to read, whose damage is told in one line."""
    try:
        with (
            gzip.open(path, "rt", encoding="utf-8", newline="")
            if path.suffix == ".gz"
            else path.open(encoding="utf-8", newline="") as file
        ):
            yield file
    except UvmsError:
        raise
    except (OSError, EOFError, zlib.error, csv.Error, ValueError, IndexError) as error:
        raise InvalidInput(f"{path}: no table of numbers ({' '.join(str(error).split())[:200]})") from None


def _rows_of(file: IO[str]) -> Iterator[str]:
    for line in iter(lambda: file.readline(LONGEST_LINE), ""):
        if len(line) == LONGEST_LINE:
            raise InvalidInput(f"{getattr(file, 'name', '')}: a line of more than {LONGEST_LINE >> 20} MB")
        if not line.startswith(_COMMENT):
            yield line


def _places(path: Path, header: Sequence[str], wanted: Sequence[str]) -> list[int]:
    names = [name.strip() for name in header]
    for name in wanted:
        if name not in names:
            raise NameNotFound(f"column of {path.name}", name, names)
    return [names.index(name) for name in wanted]


def _numbers(rows: Iterable[list[str]], places: Sequence[int]) -> Iterator[float]:
    """One row after the other."""
    for number, row in enumerate(rows):
        if number >= MOST_ROWS:
            raise InvalidInput(f"more than {MOST_ROWS} rows; give recordings one by one")
        if row:
            yield from [float(row[place]) if row[place].strip() else np.nan for place in places]


def _from_parquet(path: Path, wanted: Sequence[str]) -> np.ndarray:
    with _parquet(path) as file:
        require_numbers(file, path, wanted)
        table = file.read(columns=list(wanted))
        return np.column_stack([_floats(table.column(name)) for name in wanted])


def _floats(column: Any) -> np.ndarray:
    """Convert a column to floats, NaN for missing values; time stamps since 1970, in their own unit."""
    from pyarrow import types

    kind = "int64" if types.is_timestamp(column.type) else "float64"
    return np.asarray(column.cast(kind, safe=False).to_numpy(), dtype=float)


@contextmanager
def _parquet(path: Path) -> Iterator[Any]:
    try:
        from pyarrow import ArrowException, parquet
    except ImportError:
        raise NotInstalled("reading Parquet", "pyarrow") from None
    try:
        with parquet.ParquetFile(path) as file:
            if file.metadata.num_rows > MOST_ROWS:
                raise InvalidInput(f"{path}: more than {MOST_ROWS} rows; give recordings one by one")
            yield file
    except UvmsError:
        raise
    except (ArrowException, OSError, ValueError) as error:
        raise InvalidInput(f"{path}: no Parquet file ({' '.join(str(error).split())[:200]})") from None


def write_columns(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns (n,) [as they are] by their names, NaN as an empty cell; the ending of the path says what kind of table.

    Raises NotInstalled where Parquet cannot be written.
    """
    if path.suffix == ".parquet":
        _to_parquet(path, columns)
        return
    with gzip.open(path, "wt", newline="") if path.suffix == ".gz" else path.open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(columns)
        rows.writerows(
            ["" if np.isnan(x) else repr(float(x)) for x in row] for row in zip(*columns.values(), strict=True)
        )


def _to_parquet(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise NotInstalled("writing Parquet", "pyarrow") from None
    parquet.write_table(pyarrow.table(dict(columns)), path)


# A recording as one file, CSV or Parquet, by its ending: a row for every time, cells only for channels that have a sample.

_TIME = "t [s]"
_COLUMN = re.compile(r"(\w+)\.(\w+)$")


def write_recording(recording: Recording, path: Path) -> None:
    """Write it. Raises NotInstalled where Parquet cannot be written."""
    times = np.unique(np.concatenate([channel.t for channel in recording.channels.values()]))
    columns = {_TIME: times}
    for name, channel in recording.channels.items():
        at = np.searchsorted(times, channel.t)
        for label, values in zip(
            _labels(name, channel), (*channel.values.T, np.full(len(at), channel.delay)), strict=True
        ):
            columns[label] = np.full(len(times), np.nan)
            columns[label][at] = values
    write_columns(path, columns)


def _labels(name: str, channel: Channel) -> tuple[str, ...]:
    own = CHANNEL_KINDS[name].columns or tuple(str(k) for k in range(channel.values.shape[1]))
    return (*(f"{name}.{column}" for column in own), f"{name}.delay")


def is_stored(names: Collection[str]) -> bool:
    """Recognise a table of this toolkit by the names of its columns."""
    return _TIME in names


def stored_recording(path: Path) -> Recording:
    """Read what `write_recording` has written. Raises InvalidInput for another file, and NotInstalled."""
    names = column_names(path)
    found: dict[str, list[str]] = {}
    for column in names:
        match = _COLUMN.match(column)
        if match:
            found.setdefault(match[1], []).append(column)
    if not is_stored(names) or not found:
        raise InvalidInput(f"{path}: no recording of ours; give a mapping of its columns")
    return Recording(
        name=path.name.partition(".")[0],
        channels={
            name: _channel(f"{path}: {name}", read_columns(path, [_TIME, *columns])) for name, columns in found.items()
        },
    )


def _channel(where: str, rows: np.ndarray) -> Channel:
    there = rows[np.isfinite(rows).all(axis=1)]
    if len(there) < 2:
        raise InvalidInput(f"{where} has {len(there)} samples; allowed: 2 or more, or leave its columns out")
    return Channel(t=there[:, 0], values=there[:, 1:-1], delay=float(there[0, -1]))
