"""The record of a run or of a plan: named time series and metadata, saved and loaded without
pickle.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile

import numpy as np

from uvms_ocp.checks import checked, checked_dataclass, checked_on_failure
from uvms_ocp.errors import InvalidInput, NameNotFound, require_known
from uvms_ocp.model_errors import printable
from uvms_ocp.record import display, durable_files, mcap, output, row_rates, table_files
from uvms_ocp.record.array_file import read_arrays
from uvms_ocp.record.row_files import META, forget, parts, read_row_files
from uvms_ocp.record.run_meta import PlanMeta, RunMeta, read_meta, write_meta
from uvms_ocp.record.series_checks import MEASURED, check_series
from uvms_ocp.record.tables import meaning_of, unit_of
from uvms_ocp.record.untrusted import SMALL, as_input_errors, read_text
from uvms_ocp.types import Finite, Positive

_META_KEY = "__meta__"
_RENAMED = {
    "q_measured": "q_estimated",
    "v_measured": "v_estimated",
    "q_spread": "q_std",
    "altimeter_spread": "altimeter_std",
    "gates": "activations",
}
"""Names of series in older files."""
_ROUNDING = 1e-6  # share of a period by which a row may be early
_SAME_TIME = 1e-6  # [s] below which two times are one
_LARGEST_META = 16 << 20  # [B]


@checked_dataclass(eq=False, repr=False)
class Record(display.TableDisplay):
    """Named time series that share their first axis, and what is needed to read them.

    Plots and reports read nothing else. Raises `InvalidInput` for metadata of any other type.
    """

    series: Mapping[str, np.ndarray]
    """Arrays (n, ...) by name, read-only; ``t`` (n,) [s] is always there."""
    meta: RunMeta | PlanMeta
    """Metadata: scenario, robot, names of quantities, phases, and what became of it."""

    def __len__(self) -> int:
        return len(self.series["t"])

    def _table(self) -> display.SmallTable:
        t = self.series["t"]
        meta = self.meta
        title = f"Record of a {meta.kind}, {meta.scenario}, {meta.robot}: {len(t)} rows, "
        title += f"{t[0]:g} to {t[-1]:g} s" if len(t) else "no time"
        if meta.kind == "run":
            title += ", completed" if meta.completed else ", not completed"
        rows = list[tuple[str, ...]]()
        for name, array in self.series.items():
            rows.append((name, str(array.shape), unit_of(name, meta=meta), meaning_of(name)))
        return display.SmallTable(
            title=title, head=("series", "shape", "unit", "meaning"), rows=tuple(rows)
        )

    @checked_on_failure
    def __getitem__(self, name: str) -> np.ndarray:
        """Return the series `name` (n, ...), or that of a measured quantity such as
        ``T.position_error``.

        Raises `NameNotFound` with the names there are.
        """
        forget(self.series.values())  # pages read before, where series are mapped
        if name in self.series:
            return self.series[name]
        if name in self.meta.quantities and "quantities" in self.series:
            return self.series["quantities"][:, self.meta.quantities.index(name)]
        raise NameNotFound("series", name, [*sorted(self.series), *self.meta.quantities])

    @property
    def duration(self) -> float:
        """Time from the first row to the last [s]; 0 without rows."""
        t = self.series["t"]
        return float(t[-1] - t[0]) if len(t) else 0.0

    @checked
    def at(self, time: Finite) -> dict[str, np.ndarray]:
        """Return the newest row at a time [s]: the values of every series at the last tick that is
        not after it.

        Raises `InvalidInput` for a time before the first row or after the last.
        """
        t = self.series["t"]
        if not len(t) or not t[0] - _SAME_TIME <= time <= t[-1] + _SAME_TIME:
            extent = f"{t[0]:g} to {t[-1]:g} s" if len(t) else "no time at all"
            raise InvalidInput(f"time = {time:g} s has no row; the record is of {extent}")
        row = max(int(np.searchsorted(t, time + _SAME_TIME, side="right")) - 1, 0)
        return {name: array[row] for name, array in self.series.items()}

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

    def save(self, path: Path | str) -> Path:
        """Write one ``.npz`` file, and return its path; arrays stay arrays, `meta` becomes a JSON
        string. A file of that name is replaced as a whole.

        Series are compressed unless they take more than 64 MB together, or would be hardly smaller.
        """
        text = np.array(write_meta(self.meta))
        is_small = sum(array.nbytes for array in self.series.values()) <= SMALL
        # Level 1 is the quickest: slower ones save one or two per cent.
        with (
            durable_files.replacing(Path(path)) as new_file,
            ZipFile(new_file, "w", compresslevel=1) as archive,
        ):
            for name, array in {_META_KEY: text, **self.series}.items():
                values = np.atleast_1d(array)
                if is_small and _packs_well(values):
                    archive.compression = ZIP_DEFLATED
                else:
                    archive.compression = ZIP_STORED
                header = np.lib.format.header_data_from_array_1_0(array)
                header["fortran_order"] = False
                with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                    np.lib.format.write_array_header_1_0(file, header)
                    for (rows,) in parts(values):
                        file.write(rows.tobytes())
        return Path(path)

    def to_dataframe(self) -> Any:
        """Return a pandas.DataFrame, one row per tick; `uvms_ocp.record.tables.SERIES` says what
        the columns are.

        Raises `NotInstalled` without pandas, as do the files below.
        """
        return table_files.to_dataframe(self.series, self.meta)

    def to_csv(self, path: Path | str) -> Path:
        """Write the table of `to_dataframe`, every number in full; returns the path. Raises `OutputError`,
        `NotInstalled`.
        """
        table_files.to_csv(self.series, self.meta, Path(path))
        return Path(path)

    def to_parquet(self, path: Path | str) -> Path:
        """Write a file that `from_parquet` reads as the same record; returns the path. Raises `OutputError`,
        `NotInstalled`.
        """
        table_files.to_parquet(self.series, self.meta, Path(path))
        return Path(path)

    @staticmethod
    def from_parquet(path: Path | str) -> Record:
        """Read a file of `to_parquet`. Raises `InvalidInput` for another or a damaged one, and
        `NotInstalled`.
        """
        return _fitting(*table_files.from_parquet(Path(path)))

    def to_mcap(
        self,
        path: Path | str,
        *,
        series: Sequence[str] | None = None,
        rate: Positive | None = None,
        urdf: Path | str | None = None,
    ) -> Path:
        """Write a file that ROS 2 and Foxglove open, and `from_mcap` reads as the same record, or
        the part that was chosen; returns its path.

        series: names of those to write beside ``t``, by default all. rate [Hz]: rate of rows, by
        default every tick; the last tick always has one. With fewer rows ``meta.dt`` is their mean
        period, and each has the newest ``measured_`` reading since the row before. urdf: file of the
        robot's description, such as ``robot.urdf``, which goes onto ``/robot_description``. Raises
        `NameNotFound` for an unknown series, `InvalidInput` for a file that is no text,
        `OutputError`, `NotInstalled`.

        ``/tf`` has the poses of vehicle, its estimate and tool, ``/tf_static`` those of goals,
        ``/odometry`` and ``/odometry_estimated`` pose and velocity, ``/joint_states`` what a URDF
        moves by, ``/wrench`` and others the forces, ``/log`` phases, alarms and faults, all by
        types of ROS 2, and ``/series/...`` every series by a type of its own.
        """
        for name in series or ():
            require_known("series", name, self.series)
        names = self.series if series is None else ("t", *series)
        rows = self._rows_at(rate)
        chosen = dict[str, np.ndarray]()
        for name, array in self.series.items():
            if name not in names:
                continue
            if name in MEASURED:
                chosen[name] = row_rates.newest_readings(array, rows)
            else:
                chosen[name] = array[rows]
        t = self.series["t"]
        meta = self.meta
        if meta.kind == "run" and 1 < len(rows) < len(t):
            mean_period = float(np.ptp(t)) / (len(rows) - 1)  # [s]
            meta = meta.model_copy(update={"dt": mean_period})
        urdf_text = None
        if urdf is not None:
            with as_input_errors(Path(urdf)):
                urdf_text = read_text(Path(urdf), SMALL)
        mcap.to_mcap(chosen, meta, Path(path), urdf_text)
        return Path(path)

    def _rows_at(self, rate: float | None) -> np.ndarray:
        """Return the indices of the first row of each period of a rate [Hz], by default of all rows,
        and of the last row, which has the end of the run.
        """
        t = self.series["t"]
        if rate is None:
            periods = np.arange(len(t))
        else:
            periods = np.floor((t - t[:1]) * rate + _ROUNDING)
        _, first_rows = np.unique(periods, return_index=True)
        return np.unique([*first_rows, len(t) - 1])

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

        path: a file, a folder of results, whose writing may have been cut off
        (`uvms_ocp.record.output.recover_folder` mends that), or the folder to which a run writes its
        rows while it goes on, see `Scenario.run`; of a run that was cut off there are as many rows as
        it wrote. only: series that are wanted, all by default. Series of more than 1 MB that are not
        compressed, and those of a folder of rows, are mapped: read from the disk when they are used.

        Raises `InvalidInput`, in one line, for what is no such file, is damaged or too large, and
        for series that do not fit each other, their times or the metadata.
        """
        try:
            meta_path = Path(path, META)
            if meta_path.is_file():
                with as_input_errors(Path(path)):
                    # The metadata first, as a run that goes on adds rows.
                    meta_text = read_text(meta_path, _LARGEST_META)
                    return _fitting(read_row_files(Path(path)), meta_text)
            record_path = Path(path, output.RECORD)
            if record_path.is_file():
                path = record_path
            names = None
            if only is not None:
                old_names = [old for old, new in _RENAMED.items() if new in only]
                names = {"t", _META_KEY, *only, *old_names}
            arrays = _renamed(read_arrays(path, names))
            return _fitting(arrays, _metadata_text(arrays))
        except InvalidInput as error:
            raise InvalidInput(
                f"{printable(path)}: not a record written by uvms_ocp: {error}"
            ) from error


def _packs_well(array: np.ndarray) -> bool:
    """Check whether compression saves a sixth of some rows sampled from end to end: numbers of many
    digits shrink less, and take longest.
    """
    sample = array[:: 1 + len(array) // 64].tobytes()
    return 6 * len(zlib.compress(sample, 1)) < 5 * len(sample)


def _fitting(series: Mapping[str, np.ndarray], meta: RunMeta | PlanMeta | str) -> Record:
    """Return the record of a file. Raises `InvalidInput` for series that do not fit each other or
    the metadata, and where there is no metadata.
    """
    if isinstance(meta, str):
        meta = read_meta(meta)
    record = Record(series=_renamed(series), meta=meta)
    check_series(record.series, record.meta)
    return record


def _renamed(series: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Give series of older files their names of today."""
    return {_RENAMED.get(name, name): array for name, array in series.items()}


def _metadata_text(arrays: dict[str, np.ndarray]) -> str:
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

    of: name of the series that has it, such as ``quantities_most``.
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
