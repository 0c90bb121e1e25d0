"""Recognise what kind of recording a file is, by its first bytes rather than its ending."""

from __future__ import annotations

import csv
import gzip
import re
import zlib
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, get_args

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.text_files import LONGEST_LINE
from uvms_ocp.record.untrusted import as_input_errors, require_regular_file

Table = Literal["text", "workbook", "parquet", "npz", "mat", "hdf5", "npy", "arrays"]
Messages = Literal["mcap", "bag", "sqlite", "json", "dataflash", "tlog", "ulog"]
Kind = Table | Messages
MESSAGES: tuple[Kind, ...] = get_args(Messages)
"""Kinds that hold messages of topics; all others are tables."""
BAG_METADATA = "metadata.yaml"
"""Name of the file that describes a folder of ROS 2."""


def _kinds() -> dict[bytes, tuple[Any, str]]:
    """Read the table ``file_kinds.csv``."""
    table = files("uvms_ocp.identification") / "file_kinds.csv"
    _, *rows = csv.reader(table.read_text(encoding="utf-8").splitlines())
    kinds = dict[bytes, tuple[Any, str]]()
    for escaped_bytes, kind, advice in rows:
        first_bytes = escaped_bytes.encode().decode("unicode_escape").encode("latin-1")
        kinds[first_bytes] = kind, advice
    return kinds


_KINDS = _kinds()
"""Kind and advice by the first bytes of files; of kinds that are not read a description."""
_JSON = re.compile(rb"(\xef\xbb\xbf)?\s*(\{|\[\s*[{\[])")
_MAVLINK_STARTS = (0xFD, 0xFE)
_STAMP = 8  # [B] before each message of a .tlog


def kind_of(path: Path) -> Kind:
    """Tell the kind of a file. Raises InvalidInput for one that is empty, of a kind that is not
    read, or no file.
    """
    require_regular_file(path)
    with path.open("rb") as file:
        head = file.read(64)
    if not head:
        raise InvalidInput(f"{path}: is empty; give a recording")
    for start, (kind, cure) in _KINDS.items():
        if not head.startswith(start):
            continue
        if cure:
            raise InvalidInput(f"{path}: {kind}, which is not read; {cure}")
        return kind
    if _JSON.match(head):
        return _kind_of_json(path)
    if head.startswith(b"PK\x03\x04"):
        if b".npy" in head:
            return "npz"
        return _archive(path)
    if path.suffix == ".alog" and head.startswith(b"%"):
        raise InvalidInput(
            f"{path}: a log of MOOS, which is not read; turn it into a table, a column for each"
            " variable that is wanted"
        )
    if path.suffix == ".tlog" and len(head) > _STAMP and head[_STAMP] in _MAVLINK_STARTS:
        return "tlog"
    if head.startswith(b"\x1f\x8b"):
        return _packed_text(path)
    return "text"


def _kind_of_json(path: Path) -> Kind:
    """Lines of objects are messages; one object, or one list, has arrays."""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        first = file.readline(LONGEST_LINE).strip()
        more = file.read(64).strip()
    if first.startswith("{") and first.endswith("}") and (more or "[" not in first):
        return "json"
    return "arrays"


def _archive(path: Path) -> Kind:
    """Tell the kind of a zip file whose first member is no array."""
    from zipfile import BadZipFile, ZipFile

    names = list[str]()
    with suppress(BadZipFile, OSError, ValueError), ZipFile(path) as archive:
        names = archive.namelist()
    if "xl/workbook.xml" in names:
        return "workbook"
    if any(name.endswith(".npy") for name in names):
        return "npz"
    raise InvalidInput(f"{path}: a zip archive, which is not read; unpack it")


def _packed_text(path: Path) -> Kind:
    """Recognise packed text. Raises InvalidInput for other packed files."""
    with (
        as_input_errors(path, OSError, EOFError, zlib.error, what="no table of numbers"),
        gzip.open(path) as file,
    ):
        head = file.read(64)
    if _JSON.match(head) or any(head.startswith(start) for start in _KINDS):
        raise InvalidInput(
            f"{path}: packed by gzip, in which tables of text alone are read; unpack it"
        )
    return "text"


def holds_messages(path: Path) -> bool:
    """Recognise a file or a folder of messages; nothing that is not there."""
    if path.is_dir():
        return (path / BAG_METADATA).is_file()
    return path.is_file() and kind_of(path) in MESSAGES
