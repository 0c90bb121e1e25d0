"""A recording of any file: one of ours, a record of a run, or one of others with a mapping."""

from __future__ import annotations

from pathlib import Path

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.identification.recordings.mapping import Mapping, mapped_recording
from uvms_ocp.identification.recordings.messages import holds_messages, topics_of
from uvms_ocp.identification.recordings.recording import Recording
from uvms_ocp.identification.recordings.run_records import run_recording
from uvms_ocp.identification.recordings.storage import is_stored, stored_recording
from uvms_ocp.identification.recordings.tables import column_names, require_there
from uvms_ocp.record import Record

_OWN_ALONE = ".npz"  # files of others do not end so
_RECORDS = {_OWN_ALONE: Record.load, ".mcap": Record.from_mcap, ".parquet": Record.from_parquet}


def read_recording(path: Path, mapping: Mapping | None = None) -> Recording:
    """The recording of a file or a folder; mapping: for what is none of ours.

    Raises InvalidInput for one that needs a mapping, NameNotFound and NotInstalled.
    """
    require_there(path)
    if mapping is not None and path.is_dir():
        return mapped_recording(path, mapping)
    try:
        return _own(path)
    except InvalidInput:
        if mapping is None or path.suffix == _OWN_ALONE:
            raise
    return mapped_recording(path, mapping)


def _own(path: Path) -> Recording:
    if path.suffix == _OWN_ALONE or (holds_messages(path) and path.is_file()):
        return _of_record(path)
    if holds_messages(path):
        raise _needs_mapping(path)
    return stored_recording(path) if path.suffix != ".parquet" or is_stored(column_names(path)) else _of_record(path)


def _of_record(path: Path) -> Recording:
    try:
        record = _RECORDS[path.suffix](path)
    except InvalidInput:
        if holds_messages(path):
            raise _needs_mapping(path) from None
        raise
    return run_recording(record, path.parent.name if path.stem == "record" else path.name.partition(".")[0])


def _needs_mapping(path: Path) -> InvalidInput:
    return InvalidInput(f"{path}: no record of ours; give a mapping of its topics: {', '.join(topics_of(path))}")
