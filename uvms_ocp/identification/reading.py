"""Read a recording from any file: one of ours, a record of a run, or one of other software with a
mapping of its columns (`uvms_ocp.identification.channel_mapping`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification import file_kinds, recording as recordings, tables
from uvms_ocp.identification.channel_mapping import RecordingMapping
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.messages import topics_of
from uvms_ocp.identification.run_recordings import SERIES_READ, run_recording
from uvms_ocp.record import output
from uvms_ocp.record.record import Record
from uvms_ocp.record.row_files import META

_RECORD_MEMBER = b"__meta__.npy"  # the first array of a record in an archive of NumPy
_RECORDS: Mapping[str, Callable[[Path], Record]] = {
    ".npz": partial(Record.load, only=SERIES_READ),
    ".mcap": Record.from_mcap,
    ".parquet": Record.from_parquet,
}


@checked
def read_recording(
    path: Path | str, mapping: RecordingMapping | None = None
) -> recordings.Recording:
    """Read the recording of a file or a folder; mapping: for files of other software.

    Raises InvalidInput for one that needs a mapping, NameNotFound and NotInstalled.
    """
    path = Path(path)
    tables.require_there(path)
    if mapping is not None and path.is_dir():
        return mapped_recording(path, mapping)
    try:
        return _without_mapping(path)
    except InvalidInput:
        if mapping is None or _is_record_archive(path):
            raise
    return mapped_recording(path, mapping)


def _is_record_archive(path: Path) -> bool:
    """Recognise a record of ours, also a damaged one, by the first array in it."""
    with path.open("rb") as file:
        return path.suffix == ".npz" and _RECORD_MEMBER in file.read(64)


def _without_mapping(path: Path) -> recordings.Recording:
    """Read a file of this toolkit: a record of a run, or a stored recording."""
    if path.is_dir():
        has_results = (path / output.RECORD).is_file()
        has_rows = (path / META).is_file()
        if has_results or has_rows:
            return _of_record(path)
        raise _needs_mapping(path)
    kind = file_kinds.kind_of(path)
    if path.suffix == ".npz" or kind == "mcap":
        return _of_record(path)
    if file_kinds.holds_messages(path):
        raise _needs_mapping(path)
    if kind != "parquet" or tables.is_stored(tables.column_names(path)):
        return tables.stored_recording(path)
    return _of_record(path)


def _of_record(path: Path) -> recordings.Recording:
    """Read a record of this toolkit as a recording."""
    try:
        record = _RECORDS.get(path.suffix, Record.load)(path)
    except InvalidInput:
        if file_kinds.holds_messages(path):
            raise _needs_mapping(path) from None
        raise
    if path.stem == "record":
        name = path.parent.name
    else:
        name = path.name.partition(".")[0]
    return run_recording(record, name)


def _needs_mapping(path: Path) -> InvalidInput:
    """Make the error for a file of other software without a mapping."""
    return InvalidInput(
        f"{path}: no record of ours; give a mapping of its topics: {', '.join(topics_of(path))}"
    )
