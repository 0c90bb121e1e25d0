"""Read the arrays of an ``.npz`` file whose sizes are known before any of them is read, and of
which nothing is executed.
"""

from __future__ import annotations

import math
import struct
import warnings
import zlib
from collections.abc import Collection, Mapping
from lzma import LZMAError
from pathlib import Path
from tokenize import TokenError
from types import MappingProxyType
from typing import Any
from zipfile import ZIP_STORED, BadZipFile, ZipFile, ZipInfo

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.untrusted import DENSEST, SMALL, require_regular_file

_MAX_ARRAYS = 256
"""Largest number of arrays of a file."""
_LARGE = 1 << 20
"""[B] size from which on an array that is not packed is mapped, and size of a part that is read at once."""
_NAME_LENGTH_OFFSET = 26
"""[B] place in a member's header at which the length of its name stands, 2 B, and after it the length of
its extra field, 2 B (APPNOTE of PKZIP, 4.3.7).
"""
_SUFFIX = ".npy"
"""Suffix of an array in an archive."""
_KINDS = "fiubU"
"""Kinds of arrays, `dtype.kind`: numbers and text, no objects, which would be unpickled."""
_HEADER_READERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
"""Functions that read the head of an array, by the version of its format."""
_ARCHIVE_ERRORS = (OSError, EOFError, BadZipFile, zlib.error, LZMAError, struct.error)
_HEADER_ERRORS = (
    ValueError,
    TypeError,
    SyntaxError,
    TokenError,
    OverflowError,
    MemoryError,
    Warning,
)
_ZIPFILE_ERRORS = (KeyError, AttributeError, IndexError, NotImplementedError, RuntimeError)
"""Errors that `zipfile` raises for invented bytes."""
_DAMAGE = (*_ARCHIVE_ERRORS, *_HEADER_ERRORS, *_ZIPFILE_ERRORS)


def read_arrays(path: Path | str, names: Collection[str] | None = None) -> Mapping[str, np.ndarray]:
    """Read every array of the file by its name, or those that are wanted, read-only.

    Raises `InvalidInput` in one line for what is no such file, is damaged, declares more than it
    holds or, for its size, more than is ever written, or holds objects.
    """
    source = Path(path)
    require_regular_file(source)
    try:
        with warnings.catch_warnings(), source.open("rb") as file, ZipFile(file) as archive:
            warnings.simplefilter("error")  # numpy's, of headers that it has to guess at
            members = _members(archive, source.stat().st_size)
            if names is not None:
                members = {name: member for name, member in members.items() if name in names}
            mapped_file = None
            if any(map(_is_mappable, members.values())):
                mapped_file = np.memmap(file, np.uint8, "r")
            arrays = {}
            for name, member in members.items():
                arrays[name] = _array(archive, member, name, mapped_file)
            return MappingProxyType(arrays)
    except InvalidInput:
        raise
    except FileNotFoundError as error:
        raise InvalidInput(
            "No such file or directory; give the path of a file that is there"
        ) from error
    except _DAMAGE as error:
        text = (getattr(error, "strerror", None) or str(error) or type(error).__name__)[:200]
        raise InvalidInput(" ".join(f"damaged, or no .npz file ({text})".split())) from error


def _members(archive: ZipFile, size: int) -> dict[str, ZipInfo]:
    """List the arrays of an archive of that size [B] by name. Raises `InvalidInput` for too many,
    too large ones, and other contents.
    """
    listed = archive.infolist()
    if len(listed) > _MAX_ARRAYS:
        raise InvalidInput(f"{len(listed)} arrays; at most {_MAX_ARRAYS} are read")
    for member in listed:
        if not member.filename.endswith(_SUFFIX):
            raise InvalidInput(f"{member.filename[:60]!r} in it is no array")
    total = sum(member.file_size for member in listed)
    if total > max(SMALL, DENSEST * size):
        sizes = f"{total / 1e9:.3g} GB of arrays in {size / 1e6:.3g} MB"
        raise InvalidInput(f"{sizes}; at most {DENSEST} times a file are read")
    members = {member.filename.removesuffix(_SUFFIX): member for member in listed}
    if len(members) < len(listed):
        raise InvalidInput("two arrays of one name")
    return members


def _is_mappable(member: ZipInfo) -> bool:
    """Return whether an array is large and not packed."""
    return member.compress_type == ZIP_STORED and member.file_size > _LARGE


def _array(
    archive: ZipFile, member: ZipInfo, name: str, mapped_file: np.ndarray | None
) -> np.ndarray:
    """Read one array, or map it where it is large and not packed; mapped_file: bytes of the whole
    archive.
    """
    with archive.open(member) as file:
        version = np.lib.format.read_magic(file)
        if version not in _HEADER_READERS:
            raise InvalidInput(f"arrays of format {version}; 1.0 and 2.0 are read")
        shape, fortran, dtype = _HEADER_READERS[version](file)
        start = file.tell()
        n_bytes = member.file_size - start
        if dtype.kind not in _KINDS:
            raise InvalidInput(f"{name!r} holds {dtype}; numbers and text are read")
        if min(shape, default=1) < 0 or math.prod(shape) * dtype.itemsize != n_bytes:
            raise InvalidInput(
                f"{name!r} declares {dtype} of shape {_short(shape)}, but holds {n_bytes} bytes"
            )
        is_mapped = (
            mapped_file is not None and member.compress_type == ZIP_STORED and n_bytes >= _LARGE
        )
        if is_mapped:
            # to its end, where its checksum is looked at
            while file.read(_LARGE):
                pass
        content: Any = file.read()
    if mapped_file is not None and is_mapped:
        start += _content_offset(member, mapped_file)
        content = mapped_file[start : start + n_bytes]
    numbers = np.frombuffer(content, dtype=dtype)
    if fortran:
        return numbers.reshape(shape[::-1]).T
    return numbers.reshape(shape)


def _content_offset(member: ZipInfo, mapped_file: np.ndarray) -> int:
    """Return where [B] the content of a member begins: behind its header, name and extra field."""
    lengths_start = member.header_offset + _NAME_LENGTH_OFFSET
    lengths_end = lengths_start + 4
    lengths = mapped_file[lengths_start:lengths_end].tobytes()
    name_length, extra_length = struct.unpack("<HH", lengths)
    return int(lengths_end + name_length + extra_length)


def _short(shape: tuple[int, ...]) -> str:
    """Write a shape, which anyone may have invented, in a few letters."""
    first_sizes = shape[:4]
    text = "(too large)"
    if all(abs(size) < 1 << 63 for size in first_sizes):
        text = str(tuple(first_sizes))[:60]
    if len(shape) <= 4:
        return text
    return f"{text[:-1]}, ...)"
