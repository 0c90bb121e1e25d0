"""Series as tables: meaning, unit, frame and columns of each, and pandas, CSV and Parquet files of
them.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from uvms_ocp.errors import InvalidInput, optional_module, require_known
from uvms_ocp.record import output, row_rates, run_meta
from uvms_ocp.record.untrusted import DENSEST, SMALL, as_input_errors, require_regular_file

# The one table of series: what each is, its units and frame, and which columns it has; units in
# figures are from here.

_FIRST = ("position", "linear", "force")
_SECOND = ("attitude", "angular", "moment")
"""Names of the parts that a vehicle has."""

_OF_Q = ("q", "q_estimated", "measured_joint_positions")
_LINEAR = {"x", "y", "z", "surge", "sway", "heave"}
_TURNING = {"qx", "qy", "qz", "qw", "roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate"}

_NUMBERS = ("is_integer", "is_floating", "is_boolean", "is_timestamp")

VERSION = "1"
"""Version of the format of the files."""
_KEY = b"uvms_ocp"
CAMPAIGN_EXTRA = '"uvms-ocp[campaign]"'
"""Which brings pandas and pyarrow."""
Series = Mapping[str, np.ndarray]


@dataclass(frozen=True, kw_only=True, slots=True)
class SeriesKind:
    """Meaning, unit and frame of one series of a record."""

    meaning: str
    shape: str
    """Shape after the first axis, which is time."""
    units: Mapping[str, str]
    """Units by part, such as position, attitude and joints; of the part ``""`` where all columns
    have one.
    """
    frame: str = "-"
    """Frame in which it is expressed."""
    columns: tuple[str, ...] = ()
    """Names of its columns; after @ what the metadata have a name of for each."""

    @property
    def unit(self) -> str:
        """Return the units of all its parts, one after the other."""
        return ", ".join(self.units.values())


def _units(text: str) -> Mapping[str, str]:
    """Parse units by part from a text such as ``position: m; attitude: -``, or one unit for all."""
    fields = [item.rpartition(": ") for item in text.split("; ")]
    return MappingProxyType({part: unit for part, _, unit in fields})


def _rows(table: str) -> list[list[str]]:
    """Return rows of a table beside this file, without its head."""
    return [
        *csv.reader((files("uvms_ocp.record") / table).read_text(encoding="utf-8").splitlines())
    ][1:]


def _described() -> Iterator[list[str]]:
    """Yield rows of the table, with those of the series that only records of fewer rows than ticks
    have.
    """
    for name, meaning, *rest in _rows("series.csv"):
        yield [name, meaning, *rest]
        statistics = dict[str, str]()
        if name in row_rates.EXTREMES:
            statistics |= {"_least": "least", "_most": "largest"}
        if name in row_rates.MEANS:
            statistics["_mean"] = "mean size"
        for suffix, statistic in statistics.items():
            yield [
                name + suffix,
                f"{statistic} since the row before, where not every tick has one: {meaning}",
                *rest,
            ]


SERIES: Mapping[str, SeriesKind] = {
    name: SeriesKind(
        meaning=meaning,
        shape=shape,
        units=_units(units),
        frame=frame,
        columns=tuple(columns.split()),
    )
    for name, meaning, shape, units, frame, columns in _described()
}
"""By name. Controllers of one's own may record others."""


QUANTITIES: Mapping[str, str] = MappingProxyType(dict(_rows("quantities.csv")))
"""Units of what our tasks measure, by the name after the task's. Tasks of one's own may measure
more.
"""


def unit_of(name: str, part: str = "", meta: Any = None) -> str:
    """Return the unit of a series, of one of its parts, or of a quantity such as
    ``T.position_error``; "-" where nobody says.

    meta: of the record, whose joints may all turn or all slide.
    """
    if name not in SERIES:
        return of_joints(QUANTITIES.get(name.rpartition(".")[2], "-"), _slides(meta))
    units = SERIES[name].units
    if part in units:
        chosen = [units[part]]
    else:
        chosen = [*units.values()]
    return ", ".join(of_joints(unit, _slides(meta)) for unit in chosen)


def of_joints(unit: str, slides: Sequence[bool]) -> str:
    """Choose from a unit such as ``rad or m`` the one of joints that turn or slide; all of it for
    both kinds, or where nobody says.
    """
    turning, _, sliding = unit.partition(" or ")
    if not sliding or len(set(slides)) != 1:
        return unit
    if slides[0]:
        return sliding
    return turning


def _slides(meta: Any, *joints: str) -> list[bool]:
    """Tell which of the joints slide, by default of all; empty where a record does not say."""
    sliding = None if meta is None else meta.sliding
    if sliding is None:
        return []
    return [name in sliding for name in joints or meta.joints]


def meaning_of(name: str) -> str:
    """Return the meaning of a series; empty where nobody says."""
    if name in SERIES:
        return SERIES[name].meaning
    return ""


def column_names(name: str, width: int, meta: Any) -> list[str]:
    """Return names of the columns of a series of that name with so many columns (width); meta: of
    its record.
    """
    if name == "quantities":
        return [*meta.quantities]
    return [f"{name}.{column}" for column in _columns(name, width, meta)]


def column_units(name: str, width: int, meta: Any) -> list[str]:
    """Return units of the same columns."""
    if name == "quantities":
        return [unit_of(quantity, meta=meta) for quantity in meta.quantities]
    units = SERIES[name].units if name in SERIES else {"": "-"}
    columns = _columns(name, width, meta)
    unitless = {part for joint in meta.endless for part in _circle(joint)}
    slides = {joint: _slides(meta, joint) for joint in meta.joints}
    all_units = [
        of_joints(units[_part(column, units)], slides.get(column, [])) for column in columns
    ]
    return [
        "-" if name in _OF_Q and column in unitless else unit
        for column, unit in zip(columns, all_units, strict=True)
    ]


def _columns(name: str, width: int, meta: Any) -> list[str]:
    names = list[str]()
    words = SERIES[name].columns if name in SERIES else ()
    for word in words:
        entries: Iterable[Any]
        if word == "@entries":
            entries = _joint_entries(meta)
        elif word.startswith("@"):
            entries = getattr(meta, word[1:], ())
        else:
            entries = [word]
        names += [getattr(entry, "name", entry) for entry in entries]
    if len(names) != width:  # such as a fixed base, whose configuration is its joints
        if name in _OF_Q:
            joints = _joint_entries(meta)
        else:
            joints = [*meta.joints]
        if len(joints) == width:
            names = joints
        else:
            names = [str(k + 1) for k in range(width)]
    return names


def _part(column: str, units: Mapping[str, str]) -> str:
    """Return the part of a series that a column of that name is of."""
    if "" in units:
        return ""
    family: tuple[str, ...]
    if column in _LINEAR:
        family = _FIRST
    elif column in _TURNING:
        family = _SECOND
    else:
        family = ("joints", column)
    return next((part for part in units if part in family), [*units][-1])


def _joint_entries(meta: Any) -> list[str]:
    """Return what the entries of the joints in q are called: of an endless one there are two."""
    entries = list[str]()
    for name in meta.joints:
        if name in meta.endless:
            entries += _circle(name)
        else:
            entries.append(name)
    return entries


def _circle(name: str) -> tuple[str, str]:
    return f"{name}.cos", f"{name}.sin"


def series_markdown() -> str:
    """Return the table, for documentation."""
    rows = (
        f"| `{name}` | {row.meaning} | {row.shape} | {row.unit} | {row.frame} |"
        for name, row in SERIES.items()
    )
    return "\n".join(
        ("| series | meaning | shape | unit | frame |", "|---|---|---|---|---|", *rows)
    )


__doc__ = f"{__doc__}\n\n{series_markdown()}\n"


# What a Parquet file says of itself, looked at before any of it is unpacked: a few bytes may stand
# for gigabytes of rows.


def require_numbers(file: Any, path: Path, columns: Sequence[str]) -> None:
    """Raise `InvalidInput` where these columns of a ``pyarrow.parquet.ParquetFile`` are none of
    numbers, or far larger than it.

    Raises `NameNotFound` for a column that there is not.
    """
    from pyarrow import types

    schema = file.schema_arrow
    for name in columns:
        require_known(f"column of {path.name}", name, schema.names)
        kind = schema.field(name).type
        if not any(getattr(types, test)(kind) for test in _NUMBERS):
            raise InvalidInput(f"{path}: column {name} holds {str(kind)[:60]}; numbers are read")
    size = 8 * file.metadata.num_rows * len(columns)
    if size > max(SMALL, DENSEST * path.stat().st_size):
        sizes = f"{path}: {size / 1e9:.3g} GB of numbers in {path.stat().st_size / 1e6:.3g} MB"
        raise InvalidInput(f"{sizes}; at most {DENSEST} times a file are read")


# A record as a table that other programs read: pandas, Parquet, CSV; Parquet has all of it, and
# comes back.


def columns(series: Series, meta: Any) -> dict[str, np.ndarray]:
    """Return all columns (n,) [unit of their series] by name, in the order of the series."""
    flat = (flat_columns(name, array, meta, alone=name) for name, array in series.items())
    return {
        name: values
        for names, columns in flat
        for name, values in zip(names, columns.T, strict=True)
    }


def flat_columns(
    name: str, array: np.ndarray, meta: Any, *, alone: str
) -> tuple[list[str], np.ndarray]:
    """Return names of the columns of a series, `alone` of one without any, and the columns (n, k)
    of its array (n, ...) [unit of it].
    """
    flat = array.reshape(len(array), -1)
    if array.ndim > 1:
        return column_names(name, flat.shape[1], meta), flat
    return [alone], flat


def to_dataframe(series: Series, meta: Any) -> Any:
    """Return a pandas.DataFrame with one row per tick. Raises `NotInstalled` without pandas."""
    return optional_module("pandas", "a table", CAMPAIGN_EXTRA).DataFrame(columns(series, meta))


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
        for column, unit, values in zip(names, units, flat.T, strict=True):
            arrays.append(pa.array(np.ascontiguousarray(values)))
            fields.append(
                pa.field(
                    column,
                    arrays[-1].type,
                    metadata={**series_description(name, array), "unit": unit},
                )
            )
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
    parts: dict[str, list[np.ndarray]] = {}
    flat: set[str] = set()
    for field, column in zip(table.schema, table.columns, strict=True):
        metadata = field.metadata or {}
        name = metadata[b"series"].decode()
        parts.setdefault(name, []).append(column.to_numpy())
        if metadata[b"axes"] == b"1":
            flat.add(name)
    return {
        name: columns[0] if name in flat else np.stack(columns, axis=1)
        for name, columns in parts.items()
    }


def series_description(name: str, array: np.ndarray) -> dict[str, str]:
    """Return the metadata that a file holds of a series of that name; array (n, ...) [unit of
    it].
    """
    kind = SERIES.get(name)
    described = {} if kind is None else {"meaning": kind.meaning, "frame": kind.frame}
    return {"series": name, "axes": str(array.ndim), **described}


def arrow(what: str = "a Parquet file", package: str = CAMPAIGN_EXTRA) -> Any:
    """Return the library pyarrow with its Parquet. Raises `NotInstalled` without it: what needs it,
    and which package brings it.
    """
    optional_module("pyarrow.parquet", what, package)
    return optional_module("pyarrow", what, package)
