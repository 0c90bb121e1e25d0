"""Store of a campaign: its manifest, its rows as a Parquet data set in parts, its records; whole at
any moment.
"""

from __future__ import annotations

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

# A Parquet data set in parts: each is written once, whole or not at all, and a run is finished when
# its part is there.

FOLDER = "rows"
_MANY = 200  # parts, before they are joined
_GROUP = 10_000  # rows of a group in a file


arrow = partial(required_arrow, "a campaign")

_LOOKS = 20_000  # rows whose seeds are drawn again
_NEEDED = ("run", "outcome", "success", "version")

_BATCH_AGE = 2.0  # [s] after which rows go to the disk; a kill loses no older ones
_BATCH = 2000  # rows, which go there at once
RECORDS = "records"


def part_paths(folder: Path) -> list[Path]:
    """Files of the data set of a campaign, the oldest first."""
    return sorted(
        path
        for path in (folder / FOLDER).glob("part-*.parquet")
        if path.stem[len("part-") :].isdigit()
    )


def read_rows(folder: Path, identity: CampaignManifest) -> Any:
    """A pyarrow table of all finished runs, by run number, each once.

    Raises `InvalidInput` for a file that is damaged, and for rows that are not of this campaign.
    """
    pa = arrow()
    schema = schema_of(identity.types)
    tables = [_read(path, schema) for path in part_paths(folder)]
    if not tables:
        return schema.empty_table()
    table = pa.concat_tables(tables)
    fault = _not_of(table, identity)
    if fault:
        raise InvalidInput(
            f"{folder / FOLDER}: {fault}; put back what was, or move it away, and its runs are made"
            " again"
        )
    return table.take(np.unique(table["run"].to_numpy(), return_index=True)[1])


def _read(path: Path, schema: Any) -> Any:
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


def _not_of(table: Any, identity: CampaignManifest) -> str:
    """Say why these rows are not of the campaign; empty where they may be. What is not a number
    counts as none.
    """
    rows = table.to_pandas()
    incomplete_columns = [name for name in _NEEDED if table[name].null_count]
    if incomplete_columns:
        return f"a run without {incomplete_columns[0]}"
    is_outside = ~rows["run"].between(0, identity.runs - 1)
    if is_outside.any():
        return f"run {rows['run'][is_outside].iloc[0]} of a campaign with {identity.runs} runs"
    runs = rows.drop_duplicates()["run"]
    is_repeated = runs.duplicated()
    if is_repeated.any():
        return f"run {runs[is_repeated].iloc[0]} is there twice, not alike"
    rows_by_run = rows.set_index("run")
    drawn_seeds = {
        run: identity.design.seed_of(run)
        for run in rows_by_run.index[:: 1 + len(rows) // _LOOKS].tolist()
    }
    numbers = rows_by_run[[name for name, kind in identity.types.items() if kind is float]]
    failed = ~rows_by_run["success"].astype(bool)
    if "seed" in rows_by_run:
        has_seed = rows_by_run.index.isin(drawn_seeds) & ~(failed & rows_by_run["seed"].isna())
        seeds = has_seed & (
            rows_by_run["seed"].to_numpy() != rows_by_run.index.map(drawn_seeds).to_numpy()
        )
    violations = {
        "success": failed == (rows_by_run["outcome"] == COMPLETED),
        "version": rows_by_run["version"] != identity.package,
        **({"seed": seeds} if "seed" in rows_by_run else {}),
        "wall_s": rows_by_run["wall_s"] < 0.0,
        **{name: np.isinf(numbers[name]) for name in numbers},
        **{name: numbers[name].isna() & ~failed for name in identity.parameters},
    }
    for name, is_violated in violations.items():
        if is_violated.any():
            row = np.flatnonzero(is_violated)[0]
            run = rows_by_run.index[row]
            value = rows_by_run[name].to_numpy()[row]
            return f"run {run} has {name} = {value}, which no run of it has"
    return ""


def schema_of(columns: Mapping[str, type]) -> Any:
    """Return the pyarrow schema of the table."""
    pa = arrow()
    kinds = {int: pa.int64(), float: pa.float64(), str: pa.string(), bool: pa.bool_()}
    return pa.schema([(name, kinds[kind]) for name, kind in columns.items()])


# A campaign's folder while it grows: batches of rows, records, what is done already.


class CampaignFolder:
    """Folder of one campaign, for the one process that holds its lock."""

    def __init__(self, folder: Path, identity: CampaignManifest) -> None:
        """folder: it is there, and locked."""
        self.folder = folder
        self._identity = identity
        (folder / FOLDER).mkdir(parents=True, exist_ok=True)
        for leftover in (folder / FOLDER).glob("*.tmp"):
            durable_files.discard(leftover)
        names = part_paths(folder)
        self._next = 1 + max((int(path.stem.rpartition("-")[2]) for path in names), default=-1)
        self._n = len(names)
        self._waiting: list[dict[str, Any]] = []
        self._since = monotonic()
        self.finished = np.zeros(identity.runs, dtype=bool)
        table = read_rows(folder, identity)
        self.finished[table["run"].to_numpy()] = True
        self.failed = table.num_rows - int(
            np.sum(table["success"].to_numpy(zero_copy_only=False).astype(bool))
        )

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
            self._since = monotonic()
        self._waiting.append({name: done.row.get(name) for name in self._identity.columns})
        self.finished[run] = True
        self.failed += not done.row["success"]

    def flush(self, *, immediately: bool = False) -> None:
        """Bring rows to the disk that have waited for long enough; immediately: all of
        them."""
        if self._waiting and (
            immediately or len(self._waiting) >= _BATCH or monotonic() - self._since > _BATCH_AGE
        ):
            self._write(
                arrow().Table.from_pylist(self._waiting, schema=schema_of(self._identity.types))
            )
            self._waiting = []
            if self._n >= _MANY:
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
            self._n = 1
            durable_files.sync_folders([self.folder / FOLDER])

    def _write(self, table: Any) -> None:
        path = self.folder / FOLDER / f"part-{self._next:08d}.parquet"
        with whole_file(path, "free some space") as file:
            arrow().parquet.write_table(table, file, row_group_size=_GROUP)
        self._next = self._next + 1
        self._n = self._n + 1


@contextmanager
def opened(
    folder: Path, identity: CampaignManifest, sources: Mapping[str, bytes]
) -> Iterator[CampaignFolder]:
    """The folder of this campaign, new or as it was left; rows are on the disk when the block ends,
    however it does.

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
    with as_output_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path, "free some space") as file:
        file.write(content)


# The finished rows of a campaign as a table.


@checked
def read_table(folder: Path | str) -> Any:
    """A pandas.DataFrame of all finished runs of the campaign in a folder, by run number; also
    while it goes on.

    Raises `InvalidInput` where there is none, and `NotInstalled` without the extra
    ``uvms-ocp[campaign]``.
    """
    folder = Path(folder)
    return read_rows(folder, read_manifest(folder)).to_pandas()
