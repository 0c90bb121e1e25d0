"""Records as tables that other programs read: pandas, CSV and Parquet, of which Parquet has all of
a record, and comes back.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.errors import InvalidInput, optional_module, require_known
from uvms_ocp.record import output, run_meta
from uvms_ocp.record.tables import Series, column_units, flat_columns, series_description
from uvms_ocp.record.untrusted import DENSEST, SMALL, as_input_errors, require_regular_file

VERSION = "1"
"""Version of the format of Parquet files."""
_KEY = b"uvms_ocp"
CAMPAIGN_EXTRA = '"uvms-ocp[campaign]"'
"""Extra of the package that installs pandas and pyarrow."""


def to_dataframe(series: Series, meta: Any) -> Any:
    """Return a pandas.DataFrame with one row per tick. Raises `NotInstalled` without pandas."""
    return optional_module("pandas", "a table", CAMPAIGN_EXTRA).DataFrame(columns(series, meta))


def columns(series: Series, meta: Any) -> dict[str, np.ndarray]:
    """Return all columns (n,) [unit of their series] by name, in the order of the series."""
    columns_by_name = dict[str, np.ndarray]()
    for name, array in series.items():
        names, flat = flat_columns(name, array, meta, alone=name)
        columns_by_name.update(zip(names, flat.T, strict=True))
    return columns_by_name


def to_csv(series: Series, meta: Any, path: Path) -> None:
    """Write one line of names, then one per tick, every number in full. Raises `NotInstalled`, and
    `OutputError` where it cannot.
    """
    table = to_dataframe(series, meta)
    with output.whole_file(path) as file:
        table.to_csv(file, index=False)


def to_parquet(series: Series, meta: Any, path: Path) -> None:
    """Write columns with unit, frame and meaning, and the metadata of the run: `from_parquet` gives
    the same record again.

    Raises `NotInstalled` without pyarrow, and `OutputError` where it cannot be written.
    """
    pa = arrow()
    fields = []
    arrays = []
    for name, array in series.items():
        names, flat = flat_columns(name, array, meta, alone=name)
        units = column_units(name, flat.shape[1], meta)
        description = series_description(name, array)
        for column, unit, values in zip(names, units, flat.T, strict=True):
            arrow_array = pa.array(np.ascontiguousarray(values))
            arrays.append(arrow_array)
            metadata = {**description, "unit": unit}
            fields.append(pa.field(column, arrow_array.type, metadata=metadata))
    file_metadata = {_KEY: VERSION.encode(), b"meta": run_meta.write_meta(meta).encode()}
    table = pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=file_metadata))
    with output.whole_file(path) as file:
        pa.parquet.write_table(table, file)


def from_parquet(path: Path) -> tuple[dict[str, np.ndarray], Any]:
    """Read series by name and metadata of a file of `to_parquet`. Raises `InvalidInput` for another
    file, `NotInstalled`.
    """
    pa = arrow()
    with as_input_errors(path, OSError, KeyError, ValueError, pa.ArrowException):
        require_regular_file(path)
        with pa.parquet.ParquetFile(path) as file:
            file_metadata = file.schema_arrow.metadata or {}
            if file_metadata.get(_KEY) != VERSION.encode():
                raise InvalidInput(
                    f"{path}: no record of version {VERSION}; give a file that Record.to_parquet"
                    " wrote"
                )
            require_numbers(file, path, file.schema_arrow.names)
            return _series(file.read()), run_meta.read_meta(file_metadata[b"meta"].decode())


def _series(table: Any) -> dict[str, np.ndarray]:
    """Put the columns of a table together to series by name, (n,) or (n, k) each."""
    columns_by_series: dict[str, list[np.ndarray]] = {}
    one_dimensional = set[str]()
    for field, column in zip(table.schema, table.columns, strict=True):
        metadata = field.metadata or {}
        name = metadata[b"series"].decode()
        columns_by_series.setdefault(name, []).append(column.to_numpy())
        if metadata[b"axes"] == b"1":
            one_dimensional.add(name)
    series = dict[str, np.ndarray]()
    for name, columns in columns_by_series.items():
        if name in one_dimensional:
            series[name] = columns[0]
        else:
            series[name] = np.stack(columns, axis=1)
    return series


def require_numbers(file: Any, path: Path, columns: Sequence[str]) -> None:
    """Raise `InvalidInput` where these columns of a ``pyarrow.parquet.ParquetFile`` are none of
    numbers, or far larger than it: asked before any is unpacked, as a few bytes may stand for
    gigabytes of rows.

    Raises `NameNotFound` for a column that there is not.
    """
    from pyarrow import types

    number_tests = (types.is_integer, types.is_floating, types.is_boolean, types.is_timestamp)
    schema = file.schema_arrow
    for name in columns:
        require_known(f"column of {path.name}", name, schema.names)
        kind = schema.field(name).type
        if not any(is_number(kind) for is_number in number_tests):
            raise InvalidInput(f"{path}: column {name} holds {str(kind)[:60]}; numbers are read")
    size = 8 * file.metadata.num_rows * len(columns)  # [B]
    file_size = path.stat().st_size  # [B]
    if size > max(SMALL, DENSEST * file_size):
        sizes = f"{path}: {size / 1e9:.3g} GB of numbers in {file_size / 1e6:.3g} MB"
        raise InvalidInput(f"{sizes}; at most {DENSEST} times a file are read")


def arrow(what: str = "a Parquet file", package: str = CAMPAIGN_EXTRA) -> Any:
    """Return the library pyarrow with its Parquet. Raises `NotInstalled` without it: what needs it,
    and which package brings it.
    """
    optional_module("pyarrow.parquet", what, package)
    return optional_module("pyarrow", what, package)
