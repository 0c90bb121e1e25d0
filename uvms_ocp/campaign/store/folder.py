"""A campaign's folder while it grows: batches of rows, records, what is done already."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from uvms_ocp.campaign.runs.work import Done
from uvms_ocp.campaign.store.identity import SOURCES, Identity, claim_identity
from uvms_ocp.campaign.store.parts import Parts, read_rows
from uvms_ocp.campaign.store.whole_file import whole_file
from uvms_ocp.output.claim import in_one_line
from uvms_ocp.output.lock import locked
from uvms_ocp.output.manifest import STORE

_BATCH_AGE = 2.0  # [s] after which rows go to the disk; a kill loses no older ones
_BATCH = 2000  # rows, which go there at once
RECORDS = "records"


class CampaignFolder:
    """Of one campaign, for the one process that holds its lock."""

    def __init__(self, folder: Path, identity: Identity) -> None:
        """folder: it is there, and locked."""
        self.folder, self._identity = folder, identity
        self._parts = Parts(folder, identity.types)
        self._waiting: list[Mapping[str, Any]] = []
        self._since = monotonic()
        self.finished = np.zeros(identity.runs, dtype=bool)
        self.failed = 0
        table = read_rows(folder, identity.types, ("run", "success"))
        self.finished[table["run"].to_numpy()] = True
        self.failed = table.num_rows - int(np.sum(table["success"].to_numpy(zero_copy_only=False).astype(bool)))

    @property
    def left(self) -> np.ndarray:
        """(n,) [-] numbers of the runs that are not finished."""
        return np.flatnonzero(~self.finished)

    def add(self, done: Done) -> None:
        """Keep a row, and the record that comes with it, which is written first. Raises `OutputError` where the disk refuses."""
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

    def flush(self, *, now: bool = False) -> None:
        """Bring rows to the disk that have waited for long enough; now: all of them."""
        if self._waiting and (now or len(self._waiting) >= _BATCH or monotonic() - self._since > _BATCH_AGE):
            self._parts.append(self._waiting)
            self._waiting = []

    def close(self) -> None:
        """Bring all rows to the disk, in one file once the campaign is complete."""
        self.flush(now=True)
        if self.finished.all():
            self._parts.join()


@contextmanager
def opened(folder: Path, identity: Identity, sources: Mapping[str, bytes]) -> Iterator[CampaignFolder]:
    """The folder of this campaign, new or as it was left; rows are on the disk when the block ends, however it does.

    sources: copies to keep, by name. Raises `InvalidInput` for another campaign there, and `OutputError` where it cannot be
    written or another process is at it.
    """
    with ExitStack() as stack:
        with in_one_line(folder):
            folder.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked(folder / STORE))
            claim_identity(folder, identity)
            for name, content in sources.items():
                if not (folder / SOURCES / name).exists():
                    _write_whole(folder / SOURCES / name, content)
        found = CampaignFolder(folder, identity)
        try:
            yield found
        finally:
            found.close()


def _write_whole(path: Path, content: bytes) -> None:
    with in_one_line(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as file:
        file.write(content)
