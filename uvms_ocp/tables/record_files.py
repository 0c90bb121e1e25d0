"""A record as a table that other programs read: pandas, Parquet, CSV; Parquet has all of it, and comes back."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from uvms_ocp.exceptions import InvalidInput, NotInstalled, OutputError
from uvms_ocp.run_meta import read_meta, write_meta
from uvms_ocp.tables.series_table import SERIES, column_names, column_units
from uvms_ocp.untrusted.parquet_file import require_numbers
from uvms_ocp.untrusted.regular_file import require_regular

VERSION = "1"
"""Of the files."""
_KEY = b"uvms_ocp"
_EXTRA = '"uvms-ocp[campaign]"'
Series = Mapping[str, np.ndarray]


def columns(series: Series, meta: Any) -> dict[str, np.ndarray]:
    """All columns (n,) [unit of their series] by name, in the order of the series."""
    found: dict[str, np.ndarray] = {}
    for name, array in series.items():
        if array.ndim == 1:
            found[name] = array
        else:
            flat = array.reshape(len(array), -1)
            found |= dict(zip(column_names(name, flat.shape[1], meta), flat.T, strict=True))
    return found


def to_dataframe(series: Series, meta: Any) -> Any:
    """A pandas.DataFrame with one row per tick. Raises `NotInstalled` without pandas."""
    try:
        import pandas
    except ImportError:
        raise NotInstalled("a table", _EXTRA) from None
    return pandas.DataFrame(columns(series, meta))


def to_csv(series: Series, meta: Any, path: Path) -> None:
    """One line of names, then one per tick, every number in full. Raises `NotInstalled`, and `OutputError` where it cannot."""
    written(path, lambda file: to_dataframe(series, meta).to_csv(file, index=False))


def to_parquet(series: Series, meta: Any, path: Path) -> None:
    """Columns with unit, frame and meaning, and the metadata of the run: `from_parquet` gives the same record again.

    Raises `NotInstalled` without pyarrow, and `OutputError` where it cannot be written.
    """
    pa = _arrow()
    fields, arrays = [], []
    for name, array in series.items():
        flat = array[:, None] if array.ndim == 1 else array.reshape(len(array), -1)
        names = [name] if array.ndim == 1 else column_names(name, flat.shape[1], meta)
        units = column_units(name, flat.shape[1], meta)
        for column, unit, values in zip(names, units, flat.T, strict=True):
            arrays.append(pa.array(np.ascontiguousarray(values)))
            fields.append(pa.field(column, arrays[-1].type, metadata={**described(name, array), "unit": unit}))
    own = {_KEY: VERSION.encode(), b"meta": write_meta(meta).encode()}
    table = pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=own))
    written(path, lambda file: pa.parquet.write_table(table, file))


def from_parquet(path: Path) -> tuple[dict[str, np.ndarray], Any]:
    """Series by name and metadata of a file of `to_parquet`. Raises `InvalidInput` for another file, `NotInstalled`."""
    pa = _arrow()
    try:
        require_regular(path)
        with pa.parquet.ParquetFile(path) as file:
            own = file.schema_arrow.metadata or {}
            if own.get(_KEY) != VERSION.encode():
                raise InvalidInput(f"{path}: no record of version {VERSION}; give a file that Record.to_parquet wrote")
            require_numbers(file, path, file.schema_arrow.names)
            return _series(file.read()), read_meta(own[b"meta"].decode())
    except (OSError, KeyError, ValueError, pa.ArrowException) as error:
        if isinstance(error, InvalidInput):
            raise
        raise InvalidInput(f"{path}: cannot be read ({' '.join(str(error).split())[:200]})") from None


def _series(table: Any) -> dict[str, np.ndarray]:
    parts: dict[str, list[np.ndarray]] = {}
    flat: set[str] = set()
    for field, column in zip(table.schema, table.columns, strict=True):
        told = field.metadata or {}
        name = told[b"series"].decode()
        parts.setdefault(name, []).append(column.to_numpy())
        if told[b"axes"] == b"1":
            flat.add(name)
    return {name: found[0] if name in flat else np.stack(found, axis=1) for name, found in parts.items()}


def described(name: str, array: np.ndarray) -> dict[str, str]:
    """What a file says of a series of that name; array (n, ...) [unit of it]."""
    kind = SERIES.get(name)
    told = {} if kind is None else {"meaning": kind.meaning, "frame": kind.frame}
    return {"series": name, "axes": str(array.ndim), **told}


def _arrow() -> Any:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise NotInstalled("a Parquet file", _EXTRA) from None
    return pyarrow


def written(path: Path, write: Any) -> None:
    """Whole or not at all. Raises `OutputError` where it cannot be written."""
    fresh = path.with_name(path.name + ".tmp")
    try:
        write(fresh)
        fresh.replace(path)
    except OSError as error:
        fresh.unlink(missing_ok=True)
        raise OutputError(f"{path}: cannot write there ({error.strerror or error}); choose another place") from error
