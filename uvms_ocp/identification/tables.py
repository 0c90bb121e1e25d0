"""Read tables of numbers from files of unknown origin, and store recordings as such.

Text (see `uvms_ocp.identification.text_tables`) and workbooks, Parquet, and named arrays: NumPy's
``.npz``, MATLAB's ``.mat``, HDF5, one object or list of JSON. An array of two dimensions has a
column ``name[k]``, k from 0, or, where times rise along its columns, for each of its rows; in
``.npy``, where it has no name, ``#k``, from 1.
"""

from __future__ import annotations

import csv
import gzip
import json
import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import chain
from math import prod
from pathlib import Path
from typing import IO, Any

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput, optional_module
from uvms_ocp.identification.array_orientation import (
    OrientedArray,
    are_few_times,
    are_times,
    oriented,
)
from uvms_ocp.identification.file_kinds import kind_of
from uvms_ocp.identification.recording import (
    CHANNEL_KINDS,
    Channel,
    Recording,
    stated_by_format,
)
from uvms_ocp.identification.text_files import MOST_ROWS
from uvms_ocp.identification.text_tables import (
    TextFormat,
    place_of,
    text_columns,
    text_layout,
)
from uvms_ocp.record.array_file import read_arrays
from uvms_ocp.record.table_files import arrow, require_numbers
from uvms_ocp.record.untrusted import as_input_errors

_MOST_NUMBERS = 20 * MOST_ROWS  # of a file of arrays
_LARGEST_JSON = 1 << 25  # bytes that are read at once
_TIME = "t [s]"
"""Name of the column of times of a stored recording."""
_COLUMN = re.compile(r"(\w+)\.(\w+)$")
"""Name of any other column: channel and column."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TableColumns:
    """Columns of a table."""

    values: np.ndarray
    """(n, k) [as in the file], NaN for cells without a number."""
    units: tuple[str, ...]
    """Units of the columns by the file; empty where it has none."""
    remarks: tuple[str, ...] = ()
    """Sentences on parts of the file that were left out."""
    layout: str = ""
    """Layout that was detected, in words."""
    stated_unit: str = ""
    """Units of values that the file states and the channel may have."""
    notes: tuple[str, ...] = ()
    """Statements of the file about these columns, such as a scale, that were applied in reading
    them.
    """


def read_table(
    path: Path,
    columns: Sequence[str],
    text_format: TextFormat | None = None,
    words: Sequence[str | None] = (),
) -> TableColumns:
    """Read columns of a table by their names; words: for columns of text, the word that reads as 1,
    where all others read as 0.

    Raises NameNotFound for an unknown column, NotInstalled, and InvalidInput for a file without a
    table of numbers.
    """
    require_there(path)
    kind = kind_of(path)
    if kind in ("text", "workbook"):
        layout = text_layout(path, text_format)
        places = [place_of(path, layout.names, name) for name in columns]
        place_words = {}
        for place, word in zip(places, words, strict=False):
            if word is not None:
                place_words[place] = word
        values, remarks = text_columns(path, places, layout, place_words)
        units = tuple(layout.units[place] for place in places)
        return TableColumns(values=values, units=units, remarks=remarks, layout=str(layout))
    if kind == "parquet":
        return TableColumns(values=_from_parquet(path, columns), units=("",) * len(columns))
    return _from_arrays(path, columns)


def read_columns(path: Path, columns: Sequence[str]) -> np.ndarray:
    """Read columns (n, k) [as they are] of a table; raises as `read_table` does."""
    return read_table(path, columns).values


def column_names(path: Path, text_format: TextFormat | None = None) -> tuple[str, ...]:
    """Return the names of a table's columns; text_format: known parts of the layout of a text or a
    workbook.

    Raises InvalidInput for what is no table, and NotInstalled.
    """
    require_there(path)
    kind = kind_of(path)
    if kind == "parquet":
        with _parquet(path) as file:
            return tuple(file.schema_arrow.names)
    if kind in ("text", "workbook"):
        return text_layout(path, text_format).names
    return tuple(_arrays(path).columns)


def require_there(path: Path) -> None:
    """Check that a path exists. Raises InvalidInput."""
    if not path.exists():
        raise InvalidInput(f"{path}: there is no such file")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Arrays:
    """Columns of the arrays of a file, by name."""

    columns: dict[str, np.ndarray]
    """(n,) [as in the file] columns by name."""
    sources: dict[str, OrientedArray]
    """Array of each column, by the name of the column."""


def _from_arrays(path: Path, selection: Sequence[str]) -> TableColumns:
    """Read columns of a file of named arrays."""
    arrays = _arrays(path)
    known = list(arrays.columns)
    names = [known[place_of(path, known, name)] for name in selection]
    columns = [arrays.columns[name] for name in names]
    lengths = {len(column) for column in columns}
    if len(lengths) > 1 or max(lengths) > MOST_ROWS:
        pairs = zip(selection, columns, strict=True)
        sizes = ", ".join(f"{name}: {len(column)}" for name, column in pairs)
        raise InvalidInput(
            f"{path}: columns of {sizes} numbers; allowed: as many of each, at most {MOST_ROWS}"
        )
    sources = [arrays.sources[name] for name in names]
    notes = dict.fromkeys(source.note for source in sources if source.note)
    remarks = dict.fromkeys(source.remark for source in sources if source.remark)
    return TableColumns(
        values=np.column_stack(columns),
        units=("",) * len(columns),
        remarks=tuple(remarks),
        layout="; ".join(notes),
    )


def _arrays(path: Path) -> _Arrays:
    """Read all columns of a file of named arrays."""
    with as_input_errors(path):
        readers = {
            "npz": read_arrays,
            "npy": _npy_arrays,
            "mat": _mat_arrays,
            "hdf5": _hdf5_arrays,
            "arrays": _json_arrays,
        }
        arrays = {name: np.asarray(array) for name, array in readers[kind_of(path)](path).items()}
    tables: dict[str, np.ndarray] = {}
    for name, array in arrays.items():
        if array.dtype.kind == "M":
            numbers = array.astype("datetime64[ns]").astype(np.int64) * 1e-9
        else:
            numbers = array
        if numbers.dtype.kind not in "biuf" or numbers.ndim not in (1, 2) or not numbers.size:
            continue
        tables[name] = numbers.astype(float)
    vectors = [table.ravel() for table in tables.values() if table.size == max(table.shape)]
    n_times = {len(vector) for vector in vectors if are_times(vector)}
    n_few_times = {len(vector) for vector in vectors if are_few_times(vector)}
    columns: dict[str, np.ndarray] = {}
    sources: dict[str, OrientedArray] = {}
    for name, table in tables.items():
        source = oriented(table, n_times, n_few_times)
        n_columns = source.values.shape[1]
        if not name:
            names = [f"#{k + 1}" for k in range(n_columns)]
        elif n_columns == 1:
            names = [name]
        else:
            names = [f"{name}[{k}]" for k in range(n_columns)]
        columns |= zip(names, source.values.T, strict=True)
        sources |= dict.fromkeys(names, source)
    return _Arrays(columns=columns, sources=sources)


def _npy_arrays(path: Path) -> Mapping[str, np.ndarray]:
    """Read the array of a file of NumPy."""
    array = np.load(path, mmap_mode="r", allow_pickle=False)
    _require_few([("array", array.shape)])
    return dict(_flat("", array))


def _mat_arrays(path: Path) -> Mapping[str, np.ndarray]:
    """Read the variables of a file of MATLAB."""
    from scipy.io import loadmat, whosmat

    _require_few((name, shape) for name, shape, _ in whosmat(path))
    content = loadmat(path, squeeze_me=True)
    variables = {name: value for name, value in content.items() if not name.startswith("__")}
    return dict(_flat("", variables))


def _json_arrays(path: Path) -> Mapping[str, np.ndarray]:
    """Read the arrays of one object or list of JSON."""
    if path.stat().st_size > _LARGEST_JSON:
        raise InvalidInput(
            f"{path}: {path.stat().st_size >> 20} MB of JSON; at most {_LARGEST_JSON >> 20} are"
            " read at once"
        )
    try:
        return dict(_flat("", json.loads(path.read_text(encoding="utf-8-sig"), parse_int=float)))
    except ValueError as error:
        raise InvalidInput(
            f"{path}: neither lines of JSON nor one object or list ({error}); try `jq -c .`"
        ) from None


def _flat(prefix: str, value: Any) -> Iterator[tuple[str, np.ndarray]]:
    """Yield arrays of a structure and of those within it, by names with dots between them; a list
    of rows has columns.
    """
    if isinstance(value, list) and _are_rows(value):
        value = _by_column(value)
    elif isinstance(value, list):
        with suppress(TypeError, ValueError):  # words, and rows that are not alike
            value = np.array(value, dtype=float)
    names: Any
    if isinstance(value, dict):
        names = value
    else:
        names = getattr(getattr(value, "dtype", None), "names", None)
    if names:
        for name in names:
            yield from _flat(f"{prefix}.{name}" if prefix else name, value[name])
    elif isinstance(value, np.ndarray) and value.dtype == object and value.ndim == 0:
        yield from _flat(prefix, value.item())
    elif isinstance(value, np.ndarray):
        yield prefix, value


def _are_rows(values: list[Any]) -> bool:
    """Check whether values are rows with names, some of which may be missing."""
    return any(values) and all(row is None or isinstance(row, dict) for row in values)


def _by_column(rows: list[dict[str, Any] | None]) -> dict[str, list[Any]]:
    """Return columns by their names, of rows by theirs; None where a row has no such name."""
    present = [row or {} for row in rows]
    columns = {}
    for name in dict.fromkeys(chain.from_iterable(present)):
        columns[name] = [row.get(name) for row in present]
    return columns


def _hdf5_arrays(path: Path) -> Mapping[str, np.ndarray]:
    """Read the data sets of numbers of a file of HDF5."""
    h5py = optional_module("h5py", "reading HDF5", "h5py")
    with h5py.File(path) as file:
        datasets: dict[str, Any] = {}

        def collect(name: str, node: Any) -> None:
            if isinstance(node, h5py.Dataset) and node.dtype.kind in "biuf":
                datasets[name.replace("/", ".")] = node

        file.visititems(collect)
        _require_few((name, dataset.shape) for name, dataset in datasets.items())

        arrays = {}
        for name, dataset in datasets.items():
            array = dataset[()]
            if "MATLAB_class" in dataset.attrs:  # MATLAB writes its columns as rows
                array = array.T
            arrays[name] = array
        return arrays


def _require_few(shapes: Iterable[tuple[str, Sequence[int]]]) -> None:
    """Raise InvalidInput for more numbers than a recording has: a few bytes may declare any."""
    for name, shape in shapes:
        if prod(map(int, shape)) > _MOST_NUMBERS:
            raise InvalidInput(
                f"{name!r} holds {tuple(shape)} numbers; at most {_MOST_NUMBERS} are read"
            )


def _from_parquet(path: Path, selection: Sequence[str]) -> np.ndarray:
    """Read columns (n, k) of a Parquet file."""
    with _parquet(path) as file:
        names = list(file.schema_arrow.names)
        columns = [names[place_of(path, names, name)] for name in selection]
        require_numbers(file, path, columns)
        table = file.read(columns=list(dict.fromkeys(columns)))
        return np.column_stack([_floats(table.column(name)) for name in columns])


def _floats(column: Any) -> np.ndarray:
    """Convert a column to floats, NaN for missing values; time stamps since 1970, in their own
    unit.
    """
    from pyarrow import types

    kind = "int64" if types.is_timestamp(column.type) else "float64"
    return np.asarray(column.cast(kind, safe=False).to_numpy(), dtype=float)


@contextmanager
def _parquet(path: Path) -> Iterator[Any]:
    """Open a Parquet file. Raises InvalidInput for too many rows."""
    pa = arrow("reading Parquet", "pyarrow")
    damage = (pa.ArrowException, OSError, ValueError)
    with (
        as_input_errors(path, *damage, what="no Parquet file"),
        pa.parquet.ParquetFile(path) as file,
    ):
        if file.metadata.num_rows > MOST_ROWS:
            raise InvalidInput(f"{path}: more than {MOST_ROWS} rows; give recordings one by one")
        yield file


def write_columns(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns (n,) [as they are] by their names, NaN as an empty cell, as the kind of table
    that the ending of the path names.

    Raises NotInstalled where Parquet cannot be written.
    """
    if path.suffix == ".parquet":
        pa = arrow("writing Parquet", "pyarrow")
        pa.parquet.write_table(pa.table(dict(columns)), path)
        return
    with _opened_for_text(path) as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            rows.writerow("" if np.isnan(value) else repr(float(value)) for value in row)


def _opened_for_text(path: Path) -> IO[str]:
    """Open a file to write text, gzipped where its name says so."""
    if path.suffix == ".gz":
        return gzip.open(path, "wt", newline="")
    return path.open("w", newline="")


@checked
def write_recording(recording: Recording, path: Path | str) -> Path:
    """Write a recording as a table, `.csv`, `.csv.gz` or `.parquet`, that `read_recording` takes
    without a mapping: a row for every time, cells only for channels that have a sample. Returns the
    path.

    Raises NotInstalled where Parquet cannot be written.
    """
    times = np.unique(np.concatenate([channel.t for channel in recording.channels.values()]))
    columns = {_TIME: times}
    for name, channel in recording.channels.items():
        rows = np.searchsorted(times, channel.t)
        delays = np.full(len(rows), channel.delay)
        for label, values in zip(_labels(name, channel), (*channel.values.T, delays), strict=True):
            columns[label] = np.full(len(times), np.nan)
            columns[label][rows] = values
    write_columns(Path(path), columns)
    return Path(path)


def _labels(name: str, channel: Channel) -> tuple[str, ...]:
    """Return the names of the columns of a channel: its values, then its delay."""
    n_columns = channel.values.shape[1]
    columns = CHANNEL_KINDS[name].columns or tuple(map(str, range(n_columns)))
    return tuple(f"{name}.{column}" for column in (*columns, "delay"))


def is_stored(names: Collection[str]) -> bool:
    """Recognise a table of this toolkit by the names of its columns."""
    return _TIME in names


def stored_recording(path: Path) -> Recording:
    """Read what `write_recording` has written. Raises InvalidInput for another file, and
    NotInstalled.
    """
    names = column_names(path)
    columns_by_channel = defaultdict[str, list[str]](list)
    for name in names:
        match = _COLUMN.match(name)
        if match is not None:
            columns_by_channel[match[1]].append(match[0])
    if not is_stored(names) or not columns_by_channel:
        raise InvalidInput(f"{path}: no recording of ours; give a mapping of its columns")
    channels = {}
    for name, columns in columns_by_channel.items():
        rows = read_columns(path, [_TIME, *columns])
        channels[name] = _channel(f"{path}: {name}", rows)
    # What the recording was made of, and how late and how far off it is, the table does not say.
    return Recording(
        name=path.name.partition(".")[0],
        channels=channels,
        stated=stated_by_format(channels, ("unit", "axes")),
    )


def _channel(where: str, rows: np.ndarray) -> Channel:
    """Return a channel of rows (n, k) of time, values and delay."""
    samples = rows[np.isfinite(rows).all(axis=1)]
    if len(samples) < 2:
        raise InvalidInput(
            f"{where} has {len(samples)} samples; allowed: 2 or more, or leave its columns out"
        )
    return Channel(t=samples[:, 0], values=samples[:, 1:-1], delay=float(samples[0, -1]))
