"""Arrays of an ``.npz`` file whose sizes are known before anything of them is read, and of which nothing is executed."""

from __future__ import annotations

import math
import struct
import warnings
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from lzma import LZMAError
from pathlib import Path
from tokenize import TokenError
from types import MappingProxyType
from typing import IO, Any
from zipfile import BadZipFile, ZipFile, ZipInfo

import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.untrusted.regular_file import require_regular

DENSEST = 400
"""[B/B] of all arrays of a file over the file, where they are more than `SMALL`.

A longer run makes a larger file, so that no length of it is refused; what a few bytes unpack to is. Motion packs 2 to 4
times. A robot that stands still packs 144 times and not much more: every tick has its time and two readings of a clock,
8 B after packing, beside 2 kB that hardly take any. Zeros alone pack 1,032 times, by other methods of the archive 10,000.
"""
SMALL = 64 << 20
"""[B] of arrays that fit into any memory, however few bytes they come from."""
_MOST = 256  # arrays
_SUFFIX = ".npy"
_KINDS = "fiubU"  # numbers and text: no objects, which would be unpickled
_DAMAGE = (
    *(OSError, EOFError, BadZipFile, zlib.error, LZMAError, struct.error),  # of the archive
    *(ValueError, TypeError, SyntaxError, TokenError, OverflowError, MemoryError, Warning),  # of a header
    *(KeyError, AttributeError, IndexError, NotImplementedError, RuntimeError),  # what zipfile says to invented bytes
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Declared:
    """What the header of an array says of it."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    fortran: bool

    @property
    def size(self) -> int:
        """[B]"""
        return math.prod(self.shape) * self.dtype.itemsize


def read_arrays(path: Path | str) -> Mapping[str, np.ndarray]:
    """Every array of the file by its name, read-only.

    Raises `InvalidInput` in one line for what is no such file, is damaged, declares more than it holds or, for its size,
    more than is ever written, or holds objects.
    """
    source = Path(path)
    require_regular(source)
    try:
        with warnings.catch_warnings(), source.open("rb") as file, ZipFile(file) as archive:
            warnings.simplefilter("error")  # numpy's, of headers that it has to guess at
            return MappingProxyType(_arrays(archive, source.stat().st_size))
    except InvalidInput:
        raise
    except FileNotFoundError as error:
        raise InvalidInput("No such file or directory; give the path of a file that is there") from error
    except _DAMAGE as error:
        raise InvalidInput(" ".join(f"damaged, or no .npz file ({_said(error)})".split())) from error


def _said(error: BaseException) -> str:
    return (getattr(error, "strerror", None) or str(error) or type(error).__name__)[:200]


def _arrays(archive: ZipFile, size: int) -> dict[str, np.ndarray]:
    members = _members(archive, size)
    return {name: _array(archive, member, name) for name, member in members.items()}


def _members(archive: ZipFile, size: int) -> dict[str, ZipInfo]:
    listed = archive.infolist()
    if len(listed) > _MOST:
        raise InvalidInput(f"{len(listed)} arrays; at most {_MOST} are read")
    for member in listed:
        if not member.filename.endswith(_SUFFIX):
            raise InvalidInput(f"{member.filename[:60]!r} in it is no array")
    total = sum(member.file_size for member in listed)
    if total > max(SMALL, DENSEST * size):
        raise InvalidInput(
            f"{total / 1e9:.3g} GB of arrays in {size / 1e6:.3g} MB; at most {DENSEST} times a file are read"
        )
    members = {member.filename.removesuffix(_SUFFIX): member for member in listed}
    if len(members) < len(listed):
        raise InvalidInput("two arrays of one name")
    return members


def _array(archive: ZipFile, member: ZipInfo, name: str) -> np.ndarray:
    with archive.open(member) as file:
        declared = _declared(file)
        there = member.file_size - file.tell()
        if declared.dtype.kind not in _KINDS:
            raise InvalidInput(f"{name!r} holds {declared.dtype}; numbers and text are read")
        if min(declared.shape, default=1) < 0 or declared.size != there:
            raise InvalidInput(
                f"{name!r} declares {declared.dtype} of shape {_short(declared.shape)}, but holds {there} bytes"
            )
        content = file.read()  # to its end, where its checksum is looked at
    numbers = np.frombuffer(content, dtype=declared.dtype)
    return numbers.reshape(declared.shape[::-1]).T if declared.fortran else numbers.reshape(declared.shape)


def _declared(file: IO[bytes]) -> Declared:
    version = np.lib.format.read_magic(file)
    read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in read:
        raise InvalidInput(f"arrays of format {version}; 1.0 and 2.0 are read")
    shape, fortran, dtype = read[version](file)
    return Declared(shape=shape, dtype=dtype, fortran=fortran)


def _short(shape: tuple[int, ...]) -> str:
    text = str(tuple(shape[:4]))[:60] if all(abs(n) < 1 << 63 for n in shape[:4]) else "(too large)"
    return text if len(shape) <= 4 else f"{text[:-1]}, ...)"
