"""Store of a campaign: its manifest, its rows as a Parquet data set in parts, its records; whole at
any moment.

Each part is written once, whole or not at all, and a run is finished when a part has its row.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from uvms_ocp.campaign.jobs import COMPLETED, RunResult
from uvms_ocp.campaign.manifest import (
    FILE,
    SOURCES,
    CampaignManifest,
    claim_manifest,
    read_manifest,
)
from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.record import durable_files, untrusted
from uvms_ocp.record.manifest import STORE
from uvms_ocp.record.output import as_output_errors, whole_file
from uvms_ocp.record.table_files import arrow as required_arrow

FOLDER = "rows"
"""Folder of the parts."""
RECORDS = "records"
"""Folder of the records of runs."""
_PART = re.compile(r"part-(\d+)")
"""Name of a part, without its suffix."""
_MAX_PARTS = 200
"""Parts before they are joined."""
_GROUP = 10_000
"""Rows of a group in a file."""
_BATCH = 2000
"""Rows that go to the disk at once."""
_BATCH_AGE = 2.0
"""[s] Time after which fewer rows go there, too; a kill loses no older ones."""
_CHECKED_SEEDS = 20_000
"""Rows whose seeds are drawn again."""
_REQUIRED = ("run", "outcome", "success", "version")
"""Columns without gaps."""

arrow = partial(required_arrow, "a campaign")


def part_paths(folder: Path) -> list[Path]:
    """List the parts of a campaign, the oldest first."""
    paths = sorted((folder / FOLDER).glob("part-*.parquet"))
    return [path for path in paths if _PART.fullmatch(path.stem)]


def read_rows(folder: Path, identity: CampaignManifest) -> Any:
    """Return a pyarrow table of all finished runs, by run number, each once.

    Raises `InvalidInput` for a file that is damaged, and for rows that are not of this campaign.
    """
    pa = arrow()
    schema = schema_of(identity.types)
    tables = [_read_part(path, schema) for path in part_paths(folder)]
    if not tables:
        return schema.empty_table()
    table = pa.concat_tables(tables)
    problem = _foreign_row(table, identity)
    if problem:
        raise InvalidInput(
            f"{folder / FOLDER}: {problem}; put back what was, or move it away, and its runs are"
            " made again"
        )
    _, first_rows = np.unique(table["run"].to_numpy(), return_index=True)
    return table.take(first_rows)


def _read_part(path: Path, schema: Any) -> Any:
    """Read a part as a table of this schema."""
    pa = arrow()
    advice = "; move it away, its runs are made again"
    with untrusted.as_input_errors(path, OSError, pa.ArrowException, what="damaged", advice=advice):
        table = pa.parquet.read_table(path, partitioning=None)
    if sorted(map(str, table.schema)) != sorted(map(str, schema)):
        text = f"{path}: its columns or their kinds are not those of {FILE}"
        raise InvalidInput(
            f"{text}; put back what was, or move it away, and its runs are made again"
        )
    return table.select(schema.names)


def _foreign_row(table: Any, identity: CampaignManifest) -> str:
    """Describe a row that is not of the campaign; empty where there is none. What is not a number
    counts as none.
    """
    rows = table.to_pandas()
    for name in _REQUIRED:
        if table[name].null_count:
            return f"a run without {name}"
    is_outside = ~rows["run"].between(0, identity.runs - 1)
    if is_outside.any():
        return f"run {rows['run'][is_outside].iloc[0]} of a campaign with {identity.runs} runs"
    runs = rows.drop_duplicates()["run"]
    is_repeated = runs.duplicated()
    if is_repeated.any():
        return f"run {runs[is_repeated].iloc[0]} is there twice, not alike"
    rows_by_run = rows.set_index("run")
    for name, is_violated in _violations(rows_by_run, identity):
        if is_violated.any():
            row = np.flatnonzero(is_violated)[0]
            run = rows_by_run.index[row]
            value = rows_by_run[name].to_numpy()[row]
            return f"run {run} has {name} = {value}, which no run of it has"
    return ""


def _violations(rows: Any, identity: CampaignManifest) -> Iterator[tuple[str, Any]]:
    """Yield names of columns with the rows (n,) in which they hold what no run of the campaign
    has.
    """
    failed = ~rows["success"].astype(bool)
    yield "success", failed == (rows["outcome"] == COMPLETED)
    yield "version", rows["version"] != identity.package
    if "seed" in rows:
        yield "seed", _has_another_seed(rows, identity)
    yield "wall_s", rows["wall_s"] < 0.0
    for name, kind in identity.types.items():
        if kind is float:
            yield name, np.isinf(rows[name])
    for name in identity.parameters:
        yield name, rows[name].isna() & ~failed


def _has_another_seed(rows: Any, identity: CampaignManifest) -> Any:
    """Return True for rows (n,) with another seed than the campaign draws, as far as they are
    checked; a run that failed may have none.
    """
    step = 1 + len(rows) // _CHECKED_SEEDS
    drawn_seeds = {run: identity.design.seed_of(run) for run in rows.index[::step].tolist()}
    failed = ~rows["success"].astype(bool)
    is_checked = rows.index.isin(drawn_seeds) & ~(failed & rows["seed"].isna())
    return is_checked & (rows["seed"].to_numpy() != rows.index.map(drawn_seeds).to_numpy())


def schema_of(columns: Mapping[str, type]) -> Any:
    """Return the pyarrow schema of the table."""
    pa = arrow()
    kinds = {int: pa.int64(), float: pa.float64(), str: pa.string(), bool: pa.bool_()}
    return pa.schema([(name, kinds[kind]) for name, kind in columns.items()])


class CampaignFolder:
    """Folder of one campaign while it grows, for the one process that holds its lock."""

    def __init__(self, folder: Path, identity: CampaignManifest) -> None:
        """folder: it is there, and locked."""
        self.folder = folder
        self._identity = identity
        (folder / FOLDER).mkdir(parents=True, exist_ok=True)
        for leftover in (folder / FOLDER).glob("*.tmp"):
            durable_files.discard(leftover)
        numbers = [_part_number(path) for path in part_paths(folder)]
        self._next_part = 1 + max(numbers, default=-1)
        """Number of the next part."""
        self._n_parts = len(numbers)
        self._waiting: list[dict[str, Any]] = []
        """Rows that are not on the disk yet."""
        self._waiting_since = monotonic()
        """[s] time at which the first of them came."""
        table = read_rows(folder, identity)
        success = table["success"].to_numpy(zero_copy_only=False).astype(bool)
        self.finished = np.zeros(identity.runs, dtype=bool)
        """(n_runs,) whether each run is finished."""
        self.finished[table["run"].to_numpy()] = True
        self.failed = table.num_rows - int(np.sum(success))
        """Number of runs that are finished without success."""

    @property
    def left(self) -> np.ndarray:
        """(n,) numbers of the runs that are not finished."""
        return np.flatnonzero(~self.finished)

    def add(self, done: RunResult) -> None:
        """Keep a row, and the record that comes with it, which is written first. Raises
        `OutputError` where the disk refuses.
        """
        run = int(done.row["run"])
        if self.finished[run]:
            return
        if done.attachment:
            _write_whole(self.folder / RECORDS / f"run-{run:08d}.npz", done.attachment)
        if not self._waiting:
            self._waiting_since = monotonic()
        self._waiting.append({name: done.row.get(name) for name in self._identity.columns})
        self.finished[run] = True
        self.failed += not done.row["success"]

    def flush(self, *, immediately: bool = False) -> None:
        """Bring rows to the disk that have waited for long enough; immediately: all of them."""
        is_full = len(self._waiting) >= _BATCH
        is_old = monotonic() - self._waiting_since > _BATCH_AGE
        if not self._waiting or not (immediately or is_full or is_old):
            return
        schema = schema_of(self._identity.types)
        self._write(arrow().Table.from_pylist(self._waiting, schema=schema))
        self._waiting = []
        if self._n_parts >= _MAX_PARTS:
            self._join()

    def close(self) -> None:
        """Bring all rows to the disk, in one file once the campaign is complete."""
        self.flush(immediately=True)
        if self.finished.all():
            self._join()

    def _join(self) -> None:
        """Write one file in place of many. Cut off, some rows are there twice, which readers know.
        Raises `OutputError`.
        """
        paths = part_paths(self.folder)
        if len(paths) > 1:
            self._write(read_rows(self.folder, self._identity))
            for path in paths:
                path.unlink()
            self._n_parts = 1
            durable_files.sync_folders([self.folder / FOLDER])

    def _write(self, table: Any) -> None:
        """Write a table as the next part."""
        path = self.folder / FOLDER / f"part-{self._next_part:08d}.parquet"
        with whole_file(path, "free some space") as file:
            arrow().parquet.write_table(table, file, row_group_size=_GROUP)
        self._next_part += 1
        self._n_parts += 1


def _part_number(path: Path) -> int:
    """Return the number of a part from its name."""
    _, _, number = path.stem.rpartition("-")
    return int(number)


@contextmanager
def opened(
    folder: Path, identity: CampaignManifest, sources: Mapping[str, bytes]
) -> Iterator[CampaignFolder]:
    """Yield the folder of this campaign, new or as it was left; rows are on the disk when the block
    ends, however it does.

    sources: copies to keep, by name. Raises `InvalidInput` for another campaign there, and
    `OutputError` where it cannot be written or another process is at it.
    """
    with ExitStack() as stack:
        with as_output_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            stack.enter_context(durable_files.locked(folder / STORE))
            claim_manifest(folder, identity)
            for name, content in sources.items():
                if not (folder / SOURCES / name).exists():
                    _write_whole(folder / SOURCES / name, content)
        campaign_folder = CampaignFolder(folder, identity)
        try:
            yield campaign_folder
        finally:
            campaign_folder.close()


def _write_whole(path: Path, content: bytes) -> None:
    """Write a file, whole or not at all, in a folder that is made if need be."""
    with as_output_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path, "free some space") as file:
        file.write(content)


@checked
def read_table(folder: Path | str) -> Any:
    """Return a pandas.DataFrame of all finished runs of the campaign in a folder, by run number;
    also while it goes on.

    Raises `InvalidInput` where there is none, and `NotInstalled` without the extra
    ``uvms-ocp[campaign]``.
    """
    folder = Path(folder)
    return read_rows(folder, read_manifest(folder)).to_pandas()
