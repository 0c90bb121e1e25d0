"""The one table of series of records: what each is, its units, frame and columns."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from types import MappingProxyType
from typing import Any

import numpy as np

from uvms_ocp.record import row_rates

_LINEAR_PARTS = ("position", "linear", "force")
"""Names of the parts of series along the axes of a vehicle."""
_ANGULAR_PARTS = ("attitude", "angular", "moment")
"""Names of the parts of series about the axes of a vehicle."""
_LINEAR_COLUMNS = {"x", "y", "z", "surge", "sway", "heave"}
_ANGULAR_COLUMNS = {
    *("qx", "qy", "qz", "qw"),
    *("roll", "pitch", "yaw"),
    *("roll_rate", "pitch_rate", "yaw_rate"),
}
_CONFIGURATIONS = ("q", "q_estimated", "measured_joint_positions")
"""Series in which an endless joint has two columns."""

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
    units = dict[str, str]()
    for item in text.split("; "):
        part, _, unit = item.rpartition(": ")
        units[part] = unit
    return MappingProxyType(units)


def _rows(table: str) -> list[list[str]]:
    """Return rows of a table beside this file, without its head."""
    text = (files("uvms_ocp.record") / table).read_text(encoding="utf-8")
    return [*csv.reader(text.splitlines())][1:]


def _series_rows() -> Iterator[list[str]]:
    """Yield rows of the table, with those of the series that only records of fewer rows than ticks
    have.
    """
    for name, meaning, *further_fields in _rows("series.csv"):
        yield [name, meaning, *further_fields]
        statistics = dict[str, str]()
        if name in row_rates.EXTREMES:
            statistics |= {"_least": "least", "_most": "largest"}
        if name in row_rates.MEANS:
            statistics["_mean"] = "mean size"
        for suffix, statistic in statistics.items():
            about = f"{statistic} since the row before, where not every tick has one: {meaning}"
            yield [name + suffix, about, *further_fields]


def _series() -> dict[str, SeriesKind]:
    """Read the table."""
    series = dict[str, SeriesKind]()
    for name, meaning, shape, units, frame, columns in _series_rows():
        series[name] = SeriesKind(
            meaning=meaning,
            shape=shape,
            units=_units(units),
            frame=frame,
            columns=tuple(columns.split()),
        )
    return series


SERIES: Mapping[str, SeriesKind] = _series()
"""Series of the toolkit by name; a user's controller may record more."""


QUANTITIES: Mapping[str, str] = MappingProxyType(dict(_rows("quantities.csv")))
"""Units of the quantities that tasks of the toolkit measure, by the name after the task's; a user's
tasks may measure more.
"""


def unit_of(name: str, part: str = "", meta: Any = None) -> str:
    """Return the unit of a series, of one of its parts, or of a quantity such as
    ``T.position_error``; "-" where nobody says.

    meta: of the record, whose joints may all turn or all slide.
    """
    if name not in SERIES:
        return of_joints(QUANTITIES.get(name.rpartition(".")[2], "-"), _slides(meta))
    slides = _slides(meta)
    units = SERIES[name].units
    if part in units:
        return of_joints(units[part], slides)
    return ", ".join(of_joints(unit, slides) for unit in units.values())


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
    if meta is None or meta.sliding is None:
        return []
    return [name in meta.sliding for name in joints or meta.joints]


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
    units_by_part: Mapping[str, str] = {"": "-"}
    if name in SERIES:
        units_by_part = SERIES[name].units
    circle_columns = set[str]()
    if name in _CONFIGURATIONS:
        for joint in meta.endless:
            circle_columns.update(_circle(joint))
    units = list[str]()
    for column in _columns(name, width, meta):
        if column in circle_columns:
            units.append("-")
            continue
        slides = list[bool]()
        if column in meta.joints:
            slides = _slides(meta, column)
        part = _part(column, units_by_part)
        units.append(of_joints(units_by_part[part], slides))
    return units


def _columns(name: str, width: int, meta: Any) -> list[str]:
    """Return what the columns of a series are called without its name: numbers where nobody
    says.
    """
    names = list[str]()
    if name in SERIES:
        for word in SERIES[name].columns:
            names += _entries(word, meta)
    if len(names) == width:
        return names
    # Such as a fixed base, whose configuration is its joints.
    joints = list(meta.joints)
    if name in _CONFIGURATIONS:
        joints = _joint_entries(meta)
    if len(joints) == width:
        return joints
    return [str(k + 1) for k in range(width)]


def _entries(word: str, meta: Any) -> list[str]:
    """Return the columns that a word of the table stands for: itself, or after ``@`` the names of
    what metadata lists in the field of that name.
    """
    if not word.startswith("@"):
        return [word]
    if word == "@entries":
        return _joint_entries(meta)
    return [getattr(entry, "name", entry) for entry in getattr(meta, word[1:], ())]


def _part(column: str, units: Mapping[str, str]) -> str:
    """Return the part of a series that a column of that name is of."""
    if "" in units:
        return ""
    candidates: tuple[str, ...]
    if column in _LINEAR_COLUMNS:
        candidates = _LINEAR_PARTS
    elif column in _ANGULAR_COLUMNS:
        candidates = _ANGULAR_PARTS
    else:
        candidates = ("joints", column)
    for part in units:
        if part in candidates:
            return part
    return [*units][-1]


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
    """Return the columns of an endless joint."""
    return f"{name}.cos", f"{name}.sin"


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


def series_description(name: str, array: np.ndarray) -> dict[str, str]:
    """Return the metadata that a file holds of a series of that name; array (n, ...) [unit of
    it].
    """
    description = {"series": name, "axes": str(array.ndim)}
    if name in SERIES:
        description["meaning"] = SERIES[name].meaning
        description["frame"] = SERIES[name].frame
    return description


def series_markdown() -> str:
    """Return the table, for documentation."""
    lines = ["| series | meaning | shape | unit | frame |", "|---|---|---|---|---|"]
    for name, kind in SERIES.items():
        lines.append(f"| `{name}` | {kind.meaning} | {kind.shape} | {kind.unit} | {kind.frame} |")
    return "\n".join(lines)


__doc__ = f"{__doc__}\n\n{series_markdown()}\n"
