"""Time series of one run: recorded row by row, then frozen, checked, saved and loaded without
pickle.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from operator import itemgetter
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile

import numpy as np

from uvms_ocp.checks import checked, checked_dataclass, checked_on_failure
from uvms_ocp.errors import InvalidInput, NameNotFound, OutputError, require_known
from uvms_ocp.model_errors import printable
from uvms_ocp.record import display, durable_files, mcap, output, row_rates, tables
from uvms_ocp.record.array_file import read_arrays
from uvms_ocp.record.meta_values import LARGEST, UNIT_NORM_TOLERANCE, LimitsMeta
from uvms_ocp.record.row_files import META, append_rows, forget, parts, read_row_files
from uvms_ocp.record.run_meta import (
    MIN_TICK,
    VEHICLE_Q,
    VEHICLE_V,
    PlanMeta,
    RunMeta,
    is_floating,
    read_meta,
    write_meta,
)
from uvms_ocp.record.tables import SERIES, Series, meaning_of, unit_of
from uvms_ocp.record.untrusted import SMALL, as_input_errors, read_text
from uvms_ocp.types import Positive

# What the series of a stored record have to be, so that every report and figure can bear them.

PLANNED = ("x", "x_rate", "x_acceleration", "x_jerk", "x_snap")
"""Series of planned axes, and of their derivatives."""
_LOAD = ("load_weight", "load_weight_error", "load_mass", "load_mass_error")
"""(n,) real numbers, or (n, n_tools) of several tools."""
_COLUMNS = ("altimeter_range", "altimeter_std", "joint_energy", "tick_time", "controller_time")
"""(n,) real numbers."""
_TABLES = (
    "q",
    "v",
    "command",
    "activations",
    "activity",
    "residual",
    "quantities",
    "disturbance",
    "q_std",
)
_PLANT_TABLES = ("thrust", "asked_thrust", "torque", "thruster_energy", "clearance", "current")
MEASURED = tuple(name for name in SERIES if name.startswith("measured_"))
"""Series of readings, each with when it was taken; NaN at ticks without a new one."""
_REAL = (*_COLUMNS, *_LOAD, *_TABLES, *_PLANT_TABLES, *PLANNED, *MEASURED)
_UNKNOWN = ("thruster_energy", "load_mass", *MEASURED)
"""Series in which NaN means that a value is not known."""
_ENDLESS = ("altimeter_range", "altimeter_std", "activity", "residual", "quantities")
"""Series in which infinity may stand too, such as for a range without an echo, and at ticks whose
input the solver refused.
"""
_RENAMED = {
    "q_measured": "q_estimated",
    "v_measured": "v_estimated",
    "q_spread": "q_std",
    "altimeter_spread": "altimeter_std",
    "gates": "activations",
}
"""Names of series in older files."""
_ROUNDING = 1e-6  # of a period
_WORST_HEALTH = 2
"""Codes of health: 0 good, 1 suspect, 2 lost."""

_META_KEY = "__meta__"


def check_series(series: Series, meta: RunMeta | PlanMeta) -> None:
    """Raise `InvalidInput` where the series of a file are not what `Record` promises, or do not fit
    the metadata.
    """
    if "t" not in series:
        raise InvalidInput("no series 't'")
    _check_times(series["t"])
    for name, array in series.items():
        _check_kind(name, array, series["t"])
    for name, (lower, upper) in _widths(series, meta).items():
        if name in series and not lower <= series[name].shape[1] <= upper:
            if upper == lower:
                columns = f"{lower}"
            elif upper == np.inf:
                columns = f"{lower} or more"
            else:
                columns = f"{lower} to {upper:g}"
            shape = series[name].shape
            raise InvalidInput(
                f"series {name!r} has shape {shape}; its metadata allow {shape[0]} rows of"
                f" {columns}"
            )
    _check_counts(series, meta)
    if "q" in series and is_floating(series, meta):
        for q, times in parts(series["q"], series["t"]):
            is_unit = np.abs(np.linalg.norm(q[:, 3:VEHICLE_Q], axis=1) - 1.0) <= UNIT_NORM_TOLERANCE
            if not is_unit.all():
                t = _first_wrong(times, is_unit)
                raise InvalidInput(
                    "series 'q' has a quaternion, columns 3 to 6, whose norm is not 1 at t ="
                    f" {t:g} s"
                )
    _check_health(series, meta)
    if isinstance(meta, RunMeta):
        _check_start_and_events(series["t"], meta)


def _check_times(t: np.ndarray) -> None:
    right = t.dtype == np.float64 and t.ndim == 1 and t.size and (np.abs(t) <= LARGEST).all()
    if not right or (np.diff(t) < MIN_TICK).any():
        raise InvalidInput(
            f"times t of shape {t.shape}; allowed: one or more [s], finite, each later than the one"
            " before"
        )


def _check_kind(name: str, array: np.ndarray, t: np.ndarray) -> None:
    """Raise `InvalidInput` for the wrong shape or type, and for what is not finite but is always
    known.
    """
    allowed: tuple[int, ...]
    if name in (*_COLUMNS, "saturated", "brakes"):
        allowed = (1,)
    elif name in _REAL and name not in _LOAD:
        allowed = (2,)
    else:
        allowed = (1, 2)
    if array.ndim not in allowed or len(array) != len(t) or array.dtype.kind == "U":
        if allowed == (2,):
            expected = f"{len(t)} rows of numbers"
        else:
            expected = f"numbers for {len(t)} times"
        raise InvalidInput(
            f"series {name!r} is {array.dtype} of shape {array.shape}; allowed: {expected}"
        )
    if name in _REAL and array.dtype != np.float64:
        raise InvalidInput(f"series {name!r} is {array.dtype}; allowed: float64")
    if name in _REAL:
        for rows, times in parts(array, t):
            _check_sizes(name, rows, times)


def _check_sizes(name: str, array: np.ndarray, t: np.ndarray) -> None:
    is_finite = np.isfinite(array)
    if name in _UNKNOWN:
        allowed = np.isnan(array)
    elif name in _ENDLESS:
        allowed = ~is_finite
    else:
        allowed = np.zeros_like(is_finite)
    if not (is_finite | allowed).all():
        raise InvalidInput(
            f"series {name!r} has NaN or infinity"
            f" at t = {_first_wrong(t, is_finite | allowed):g} s; record it anew"
        )
    is_small = ~is_finite | (np.abs(array) <= LARGEST)
    if not is_small.all():
        raise InvalidInput(
            f"series {name!r} is larger than {LARGEST:g} at t = {_first_wrong(t, is_small):g} s;"
            " record it anew"
        )


def _first_wrong(t: np.ndarray, right: np.ndarray) -> float:
    return float(t[np.argmin(right.reshape(len(t), -1).all(axis=1))])


def _widths(series: Series, meta: RunMeta | PlanMeta) -> dict[str, tuple[float, float]]:
    """Return the fewest and the most columns of each series that has some."""
    rows = sum(level.rows for level in meta.levels)
    widths = {
        "activations": len(meta.tasks),
        "activity": rows,
        "residual": rows,
        "quantities": len(meta.quantities),
    }
    widths |= {
        "current": 3,
        **{
            name: len(SERIES[name].columns)
            for name in MEASURED
            if "@" not in "".join(SERIES[name].columns)
        },
    }
    if isinstance(meta, PlanMeta):
        widths |= {name: len(meta.axes) for name in PLANNED} | {
            "clearance": len(meta.clearance_groups)
        }
    if meta.limits is not None:
        _check_limits(meta.limits, floating=is_floating(series, meta))
        widths["torque"] = len(meta.limits.effort)
    return {name: (n, n) for name, n in widths.items()} | _motion_widths(series, meta)


def _motion_widths(series: Series, meta: RunMeta | PlanMeta) -> dict[str, tuple[float, float]]:
    """Return columns of q and of series with one for each velocity; q has more than v where a turn
    takes several numbers.
    """
    joints = len(meta.joints)
    floating = is_floating(series, meta)
    n_v: tuple[float, float] = (joints + (VEHICLE_V if floating else 0), np.inf)
    if meta.limits is not None:
        n_v = (max(n_v[0], len(meta.limits.velocity)), len(meta.limits.velocity))
    elif "v" in series and series["v"].shape[1] >= n_v[0]:
        n_v = (series["v"].shape[1],) * 2
    n_q = n_v[0] + (VEHICLE_Q - VEHICLE_V if floating else 0)
    widths = {"q": (n_q, np.inf)} | dict.fromkeys(("v", "command", "disturbance", "q_std"), n_v)
    for rate, name, vehicle in (
        ("v", "joint_velocities", VEHICLE_V),
        ("q", "joint_positions", VEHICLE_Q),
    ):
        if rate in series:  # and the time
            widths[f"measured_{name}"] = (
                series[rate].shape[1] - (vehicle if floating else 0) + 1,
            ) * 2
    return widths


def _check_limits(limits: LimitsMeta, *, floating: bool) -> None:
    vehicle = VEHICLE_V if floating else 0
    if len(limits.velocity) - len(limits.position_lower) != vehicle:
        counts = (
            f"{len(limits.velocity)} limits of velocity and {len(limits.position_lower)} of"
            " position"
        )
        raise InvalidInput(f"{counts}; allowed: {vehicle} more of velocity, those of the vehicle")


def _check_counts(series: Series, meta: RunMeta | PlanMeta) -> None:
    counts = {"phase": len(meta.phases)}
    if isinstance(meta, RunMeta):
        counts["status"] = len(meta.statuses)
    for name, n in counts.items():
        if name in series:
            values = series[name]
            if (
                values.dtype.kind not in "iu"
                or values.ndim != 1
                or values.min() < 0
                or values.max() >= n
            ):
                raise InvalidInput(
                    f"series {name!r} counts what the metadata do not have; allowed: whole numbers"
                    f" below {n}"
                )


def _check_health(series: Series, meta: RunMeta | PlanMeta) -> None:
    if "health" not in series:
        return
    values = series["health"]
    if isinstance(meta, RunMeta):
        n = len(meta.channels)
    else:
        n = 0
    columns = values.ndim == 2 and values.shape[1] == n and values.dtype.kind in "iu"
    if not columns or (values.size and not 0 <= values.min() <= values.max() <= _WORST_HEALTH):
        shape = f"series 'health' is {values.dtype} of shape {values.shape}"
        raise InvalidInput(
            f"{shape}; allowed: whole numbers from 0 to {_WORST_HEALTH}, a column for each of {n}"
            " channels"
        )


def _check_start_and_events(t: np.ndarray, meta: RunMeta) -> None:
    if t[0] != 0.0:
        raise InvalidInput(f"a run that begins at t = {t[0]:g} s; allowed: 0 s")
    for event in meta.events:
        if not t[0] <= event.t <= t[-1]:
            raise InvalidInput(
                f"an event at {event.t:g} s; allowed: {t[0]:g} to {t[-1]:g} s, the times of the"
                " record"
            )


# The time series of one run: filled row by row, then frozen, saved and loaded without pickle.


@checked_dataclass(eq=False, repr=False)
class Record(display.TableDisplay):
    """Named time series that share their first axis, and what is needed to read them.

    Plots and reports read nothing else. Raises `InvalidInput` for metadata of any other type.
    """

    series: Mapping[str, np.ndarray]
    """By name, read-only, (n, ...) each; ``t`` (n,) [s] is always there."""
    meta: RunMeta | PlanMeta

    def __len__(self) -> int:
        return len(self.series["t"])

    def _table(self) -> display.SmallTable:
        t = self.series["t"]
        meta = self.meta
        span = f"{t[0]:g} to {t[-1]:g} s" if len(t) else "no time"
        if meta.kind != "run":
            ending = ""
        else:
            ending = ", completed" if meta.completed else ", not completed"
        return display.SmallTable(
            title=(
                f"Record of a {meta.kind}, {meta.scenario}, {meta.robot}: {len(t)} rows,"
                f" {span}{ending}"
            ),
            head=("series", "shape", "unit", "meaning"),
            rows=tuple(
                (name, str(array.shape), unit_of(name, meta=meta), meaning_of(name))
                for name, array in self.series.items()
            ),
        )

    @checked_on_failure
    def __getitem__(self, name: str) -> np.ndarray:
        """Return the series `name` (n, ...), or that of a measured quantity such as
        ``T.position_error``.

        Raises `NameNotFound` with the names there are.
        """
        forget(self.series.values())  # what was looked at before, where series are mapped
        if name in self.series:
            return self.series[name]
        if name in self.meta.quantities and "quantities" in self.series:
            return self.series["quantities"][:, self.meta.quantities.index(name)]
        raise NameNotFound("series", name, [*sorted(self.series), *self.meta.quantities])

    def _ipython_key_completions_(self) -> list[str]:
        return [*self.series, *self.meta.quantities]

    @property
    def run_meta(self) -> RunMeta:
        """`meta` of a run. Raises `InvalidInput` for a plan."""
        if self.meta.kind != "run":
            raise InvalidInput(
                f"this record is of a plan ({self.meta.scenario}); give that of a run"
            )
        return self.meta

    @property
    def plan_meta(self) -> PlanMeta:
        """`meta` of a plan. Raises `InvalidInput` for a run."""
        if self.meta.kind != "plan":
            raise InvalidInput(
                f"this record is of a run ({self.meta.scenario}); give that of a plan"
            )
        return self.meta

    def save(self, path: Path | str) -> None:
        """Write one ``.npz`` file; arrays stay arrays, `meta` becomes a JSON string. A file of that
        name is replaced as a whole.

        Series that take more than 64 MB together are not packed, nor are those that it makes hardly
        smaller.
        """
        # Level 1 is the quickest: slower ones save one or two per cent.
        text = np.array(write_meta(self.meta))
        is_small = sum(array.nbytes for array in self.series.values()) <= SMALL
        with (
            durable_files.replacing(Path(path)) as new_path,
            ZipFile(new_path, "w", compresslevel=1) as archive,
        ):
            for name, array in {_META_KEY: text, **self.series}.items():
                values = np.atleast_1d(array)
                if is_small and _packs_well(values):
                    archive.compression = ZIP_DEFLATED
                else:
                    archive.compression = ZIP_STORED
                with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                    header = np.lib.format.header_data_from_array_1_0(array) | {
                        "fortran_order": False
                    }
                    np.lib.format.write_array_header_1_0(file, header)
                    for (rows,) in parts(values):
                        file.write(rows.tobytes())

    def to_dataframe(self) -> Any:
        """Return a pandas.DataFrame, one row per tick; `uvms_ocp.record.tables.SERIES` says what
        the columns are.

        Raises `NotInstalled` without pandas, as do the files below.
        """
        return tables.to_dataframe(self.series, self.meta)

    def to_csv(self, path: Path | str) -> None:
        """Write the table of `to_dataframe`, every number in full. Raises `OutputError`,
        `NotInstalled`.
        """
        tables.to_csv(self.series, self.meta, Path(path))

    def to_parquet(self, path: Path | str) -> None:
        """Write a file that `from_parquet` reads as the same record. Raises `OutputError`,
        `NotInstalled`.
        """
        tables.to_parquet(self.series, self.meta, Path(path))

    @staticmethod
    def from_parquet(path: Path | str) -> Record:
        """Read a file of `to_parquet`. Raises `InvalidInput` for another or a damaged one, and
        `NotInstalled`.
        """
        return _fitting(*tables.from_parquet(Path(path)))

    def to_mcap(
        self,
        path: Path | str,
        *,
        series: Sequence[str] | None = None,
        rate: Positive | None = None,
        urdf: Path | str | None = None,
    ) -> None:
        """Write a file that ROS 2 and Foxglove open, and `from_mcap` reads as the same record, or
        the part that was chosen.

        series: names of those to write beside ``t``, by default all. rate [Hz]: of rows, by default
        of ticks; the last is there. Of fewer rows ``meta.dt`` is the mean period, and each has the
        newest ``measured_`` reading since the one before. urdf: file of the robot's description,
        such as ``robot.urdf``, which goes onto ``/robot_description``. Raises `NameNotFound` for a
        series that there is not, `InvalidInput` for such a file, `OutputError`, `NotInstalled`.

        ``/tf`` has the poses of vehicle, its estimate and tool, ``/tf_static`` those of goals,
        ``/odometry`` and ``/odometry_estimated`` pose and velocity, ``/joint_states`` what a URDF
        moves by, ``/wrench`` and others the forces, ``/log`` phases, alarms and faults, all by
        types of ROS 2, and ``/series/...`` every series by a type of its own.
        """
        for name in series or ():
            require_known("series", name, self.series)
        t = self.series["t"]
        names = self.series if series is None else ("t", *series)
        if rate is None:
            periods = np.arange(len(t))
        else:
            periods = np.floor((t - t[:1]) * rate + _ROUNDING)
        rows = np.unique(
            [*np.unique(periods, return_index=True)[1], len(t) - 1]
        )  # the last has what the run came to
        chosen = {name: array[rows] for name, array in self.series.items() if name in names}
        chosen |= {
            name: row_rates.newest_readings(self.series[name], rows)
            for name in chosen.keys() & {*MEASURED}
        }
        if self.meta.kind == "run" and 1 < len(rows) < len(t):
            period = {"dt": float(np.ptp(t)) / (len(rows) - 1)}
        else:
            period = {}
        with as_input_errors(Path(urdf or "")):
            if urdf is None:
                text = None
            else:
                text = read_text(Path(urdf), SMALL)
        mcap.to_mcap(chosen, self.meta.model_copy(update=period), Path(path), text)

    @staticmethod
    def from_mcap(path: Path | str) -> Record:
        """Read a file of `to_mcap`. Raises `InvalidInput` for another or a damaged one, and
        `NotInstalled`.
        """
        return _fitting(*mcap.from_mcap(Path(path)))

    @staticmethod
    def load(path: Path | str, only: Sequence[str] | None = None) -> Record:
        """Read a file written by `save`, of this version or an older one, or that in the folder of
        a command's results.

        only: series that are wanted, all by default. The file alone is read:
        `uvms_ocp.record.output.recover_folder` looks after its folder. Or, of a folder, what the
        rows of a run are written to while it goes on, see `Scenario.run`: of one that was cut off,
        those that there are. Series of more than 1 MB that are not packed, and those of a folder of
        rows, are mapped: they are read from the disk as they are looked at.

        Raises `InvalidInput`, in one line, for what is no such file, is damaged or too large, and
        for series that do not fit each other, their times or the metadata.
        """
        try:
            if (meta_path := Path(path, META)).is_file():
                with as_input_errors(Path(path)):
                    return _fitting(
                        meta=read_text(meta_path, 16 << 20), series=read_row_files(Path(path))
                    )  # which may grow
            record_path = Path(path, output.RECORD)
            path = record_path if record_path.is_file() else path
            if only is None:
                names = None
            else:
                names = {
                    "t",
                    _META_KEY,
                    *only,
                    *(old_name for old_name, new_name in _RENAMED.items() if new_name in only),
                }
            arrays = _renamed(read_arrays(path, names))
            return _fitting(arrays, _text_of(arrays))
        except InvalidInput as error:
            raise InvalidInput(
                f"{printable(path)}: not a record written by uvms_ocp: {error}"
            ) from error


def _packs_well(array: np.ndarray) -> bool:
    """Check whether packing saves a sixth of rows sampled from end to end: numbers of many digits
    lose less, and take longest.
    """
    sample = array[:: 1 + len(array) // 64].tobytes()
    return 6 * len(zlib.compress(sample, 1)) < 5 * len(sample)


def _fitting(series: Mapping[str, np.ndarray], meta: RunMeta | PlanMeta | str) -> Record:
    """Return the record of a file. Raises `InvalidInput` for series that do not fit each other or
    the metadata, and no metadata.
    """
    if isinstance(meta, str):
        meta = read_meta(meta)
    record = Record(series=_renamed(series), meta=meta)
    check_series(record.series, record.meta)
    return record


def _renamed(series: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Give series of older files their names of today."""
    return {_RENAMED.get(name, name): array for name, array in series.items()}


def _text_of(arrays: dict[str, np.ndarray]) -> str:
    """Return the metadata, taken out of the arrays."""
    if _META_KEY not in arrays:
        if {"breaks", "coefficients"} <= arrays.keys() or "summary" in arrays:
            raise InvalidInput("a plan's trajectory; give the record.npz beside it")
        raise InvalidInput(
            f"no series {_META_KEY!r}; give the record.npz that `run` or `plan` wrote"
        )
    text = arrays.pop(_META_KEY)
    if text.dtype.kind != "U" or text.shape != ():
        raise InvalidInput(
            f"metadata of shape {text.shape} and type {text.dtype}; allowed: one text"
        )
    return str(text)


@checked
def quantity(record: Record, name: str, of: str = "quantities") -> np.ndarray | None:
    """Return the series (n,) of a measured quantity such as ``T.position_error``; `None` where no
    task measures it.

    of: which series of the record has it, such as ``quantities_most``.
    """
    names = record.meta.quantities
    if name in names:
        return record[of][:, names.index(name)]
    return None


def keeps_every_tick(record: Record) -> bool:
    """Return whether every tick of a run has a row."""
    return "q_most" not in record.series


def require_every_tick(record: Record) -> RunMeta:
    """Return the metadata of a run whose every tick has a row. Raises `InvalidInput` for other
    records.
    """
    if not keeps_every_tick(record):
        raise InvalidInput(
            f"record of {record.meta.scenario} with fewer rows than ticks; record it with every"
            " tick"
        )
    return record.run_meta


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
        self._n = self._kept = self._written = 0
        self._block: dict[str, np.ndarray] = {}
        """(capacity, ...) of every series."""
        self._pick: Callable[[Mapping[str, Any]], tuple[Any, ...]] = lambda row: ()
        self._memory: dict[str, tuple[np.ndarray, BytesIO]] = {}
        """An array of each kind, and what was written of it."""

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
        if self.place == self._capacity or (
            is_first and self._every > 1
        ):  # rows end spans of ticks, the first its own
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
        contents = (
            (name, kind, memory.getvalue()) for name, (kind, memory) in self._memory.items()
        )
        return {
            name: np.frombuffer(data, kind.dtype).reshape(self._written, *kind.shape[1:])
            for name, kind, data in contents
        }

    def _keep(self) -> None:
        """Bring the rows of the block to where they stay, and then what is new to be said of
        them.
        """
        n = self._n - self._kept
        rows = {name: memory[:n] for name, memory in self._block.items() if n}
        if self._every > 1 and n:
            kept_rows = np.flatnonzero(np.arange(self._kept, self._n) % self._every == 0)
            phase_ends = np.flatnonzero(np.diff(rows.get("phase", np.zeros(n))))
            rows = row_rates.thinned_rows(rows, np.unique([*kept_rows, *phase_ends, n - 1]))
        if self._folder:
            with output.as_output_errors(
                self._folder, "make room; what was written before can be read"
            ):
                self._folder.mkdir(parents=True, exist_ok=self._kept > 0)
                append_rows(self._folder, rows, self._written)
                meta = self._news()
                if meta is not None:
                    durable_files.write_durably(self._folder / META, write_meta(meta))
        for name, part in rows.items() if self._folder is None else ():
            self._memory.setdefault(name, (part[:0].copy(), BytesIO()))[1].write(
                np.ascontiguousarray(part).data
            )
        self._kept = self._n
        self._written = self._written + len(next(iter(rows.values()), ()))

    def _begin(self, row: Mapping[str, Any]) -> None:
        kinds = {name: np.asarray(value) for name, value in row.items()}
        self._block = {
            name: np.empty((self._capacity, *kind.shape), kind.dtype)
            for name, kind in kinds.items()
        }
        # A getter of one name would give its value in place of a tuple.
        if len(kinds) > 1:
            self._pick = itemgetter(*kinds)
        else:
            self._pick = lambda row: (row[next(iter(kinds))],)
