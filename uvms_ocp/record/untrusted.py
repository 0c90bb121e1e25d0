"""Read files that anyone may have written, text, YAML, XML and arrays, within bounds of size, depth
and number.
"""

from __future__ import annotations

import json
import math
import re
import struct
import warnings
import zlib
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from copy import deepcopy
from functools import lru_cache
from lzma import LZMAError
from pathlib import Path
from tokenize import TokenError
from types import MappingProxyType
from typing import Any, NoReturn, TypeVar
from xml.etree import ElementTree
from zipfile import ZIP_STORED, BadZipFile, ZipFile, ZipInfo

import numpy as np
import yaml
from pydantic import BaseModel, ValidationError
from yaml.composer import ComposerError
from yaml.events import AliasEvent
from yaml.nodes import Node, ScalarNode

from uvms_ocp.errors import InvalidInput, UvmsError
from uvms_ocp.model_errors import one_line

_READ: ContextVar[list[Path] | None] = ContextVar("record_files_read", default=None)

DENSEST = 400
"""[B/B] of all arrays of a file over the file, where they are more than `SMALL`.

A longer run makes a larger file, so that no length of it is refused; what a few bytes unpack to is.
Motion packs 2 to 4 times. A robot that stands still packs 144 times and not much more: every tick
has its time and two readings of a clock, 8 B after packing, beside 2 kB that hardly take any. Zeros
alone pack 1,032 times, by other methods of the archive 10,000.
"""
SMALL = 64 << 20
"""[B] of arrays that fit into any memory, however few bytes they come from."""
_MOST = 256  # arrays
_LARGE = (
    1 << 20
)  # [B] of an array that is mapped where it was not packed, and of what is read at a time
_LENGTHS = 26  # [B] of the header of a member before those of its name and of what else there is
_SUFFIX = ".npy"
_KINDS = "fiubU"  # numbers and text: no objects, which would be unpickled
_DAMAGE = (
    *(OSError, EOFError, BadZipFile, zlib.error, LZMAError, struct.error),  # of the archive
    *(
        ValueError,
        TypeError,
        SyntaxError,
        TokenError,
        OverflowError,
        MemoryError,
        Warning,
    ),  # of a header
    *(
        KeyError,
        AttributeError,
        IndexError,
        NotImplementedError,
        RuntimeError,
    ),  # what zipfile says to invented bytes
)

LARGEST_XML = 16 << 20
"""[B] of a file; robots of 50 links have 0.2 MB."""
MOST_ELEMENTS = 50_000
"""Robots of 50 links have 3,000."""
DEEPEST_XML = 32
"""A URDF has 5 levels, what simulators add to it 8."""

_ENCODING = re.compile(
    rb"""\s*<\?xml[^>]*\sencoding\s*=\s*["'](us-ascii|latin-?1|(?:iso-?8859|windows|cp)-?\d+|euc-\w+|shift_jis|big5|gb\w+)["']""",
    re.IGNORECASE,
)

_M = TypeVar("_M", bound=BaseModel)
LARGEST_YAML = 16 << 20
"""[B] of a file."""
MOST_VALUES = 500_000
"""In a file, keys included, each counted as often as anchors repeat it; a mesh of 60,000
triangles.
"""
DEEPEST_YAML = 32
_LONGEST_NUMBER = 100  # characters
_INTEGER = "tag:yaml.org,2002:int"

_parsed = lru_cache(maxsize=4)(yaml.load)


# What speaks against a file, in one line with its name.


@contextmanager
def as_input_errors(
    path: Path, *kinds: type[Exception], what: str = "cannot be read", advice: str = ""
) -> Iterator[None]:
    """Raise what reading a file raises in the block as an `InvalidInput` with the file's name;
    other errors of ours pass.

    kinds: of exceptions; by default all, for libraries that say anything to bytes that nobody
    meant. advice: at the end.
    """
    try:
        yield
    except UvmsError as error:
        if type(error) is not InvalidInput or str(error).startswith(str(path)):
            raise
        raise InvalidInput(f"{path}: {error}") from None
    except Exception as error:
        if kinds and not isinstance(error, kinds):
            raise
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise InvalidInput(f"{path}: {what} ({reason}){advice}") from None


# The bytes of a file that is one: no device without end, and no pipe that waits for its writer.


@contextmanager
def record_files_read() -> Iterator[list[Path]]:
    """Yield a list that grows, inside, by every file that is read here: what the results depend
    on.
    """
    paths: list[Path] = []
    token = _READ.set(paths)
    try:
        yield paths
    finally:
        _READ.reset(token)


def note_file_read(path: Path) -> None:
    """Flags to read a file, also one that others open."""
    paths = _READ.get()
    if paths is not None:
        paths.append(path.resolve())


def require_regular_file(path: Path) -> None:
    """Raise `InvalidInput` for a folder, a device or a pipe; what does not exist is for `open` to
    tell.
    """
    if path.exists() and not path.is_file():
        raise InvalidInput("no file but a folder or a device")


def read_text(path: Path, largest: int) -> str:
    """Read the text of a file of at most ``largest`` [B].

    Raises `OSError`, and `InvalidInput` in one line for what is no file, larger, or no text in
    UTF-8.
    """
    return _decoded(_content(path, largest), "UTF-8")


def _content(path: Path, largest: int) -> bytes:
    require_regular_file(path)
    note_file_read(path)
    with path.open("rb") as file:
        content = file.read(largest + 1)
    if len(content) > largest:
        raise InvalidInput(f"larger than {largest >> 20} MB")
    return content


def _decoded(content: bytes, encoding: str) -> str:
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as error:
        raise InvalidInput(f"no text in {encoding}: {error.reason} at byte {error.start}") from None
    except LookupError:
        raise InvalidInput(
            f"encoding {encoding!r}, which is not known; save the file as UTF-8"
        ) from None


# Arrays of an ``.npz`` file whose sizes are known before anything of them is read, and of which
# nothing is executed.


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
            chosen = {
                name: member for name, member in members.items() if names is None or name in names
            }
            large = any(
                member.compress_type == ZIP_STORED and member.file_size > _LARGE
                for member in chosen.values()
            )
            if large:
                mapped_file = np.memmap(file, np.uint8, "r")
            else:
                mapped_file = None
            return MappingProxyType(
                {
                    name: _array(archive, member, name, mapped_file)
                    for name, member in chosen.items()
                }
            )
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
    listed = archive.infolist()
    if len(listed) > _MOST:
        raise InvalidInput(f"{len(listed)} arrays; at most {_MOST} are read")
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


def _array(
    archive: ZipFile, member: ZipInfo, name: str, mapped_file: np.ndarray | None
) -> np.ndarray:
    with archive.open(member) as file:
        version = np.lib.format.read_magic(file)
        header_readers = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }
        if version not in header_readers:
            raise InvalidInput(f"arrays of format {version}; 1.0 and 2.0 are read")
        shape, fortran, dtype = header_readers[version](file)
        start = file.tell()
        n_bytes = member.file_size - file.tell()
        if dtype.kind not in _KINDS:
            raise InvalidInput(f"{name!r} holds {dtype}; numbers and text are read")
        if min(shape, default=1) < 0 or math.prod(shape) * dtype.itemsize != n_bytes:
            raise InvalidInput(
                f"{name!r} declares {dtype} of shape {_short(shape)}, but holds {n_bytes} bytes"
            )
        is_mapped = (
            mapped_file is not None and member.compress_type == ZIP_STORED and n_bytes >= _LARGE
        )
        while is_mapped and file.read(_LARGE):  # to its end, where its checksum is looked at
            pass
        content: Any = file.read()
    if mapped_file is not None and is_mapped:
        lengths_start = member.header_offset + _LENGTHS
        lengths = mapped_file[lengths_start : lengths_start + 4].tobytes()
        start += lengths_start + 4 + sum(struct.unpack("<HH", lengths))
        content = mapped_file[start : start + n_bytes]
    numbers = np.frombuffer(content, dtype=dtype)
    if fortran:
        return numbers.reshape(shape[::-1]).T
    return numbers.reshape(shape)


def _short(shape: tuple[int, ...]) -> str:
    if all(abs(n) < 1 << 63 for n in shape[:4]):
        text = str(tuple(shape[:4]))[:60]
    else:
        text = "(too large)"
    if len(shape) <= 4:
        return text
    return f"{text[:-1]}, ...)"


# JSON that is an object.


def json_object(text: str, what: str = "a text", allowed: str = "an object") -> dict[str, Any]:
    """Parse a JSON text that is an object. Raises `InvalidInput` for another; what, allowed: words
    of the message.
    """
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InvalidInput(f"{what} that is no JSON: {str(error)[:200]}") from error
    if not isinstance(values, dict):
        raise InvalidInput(f"{what} that is a {type(values).__name__}; allowed: {allowed}")
    return values


# XML as a tree of elements: bounded in size, depth and number, without entities that multiply.


class _Bounded(ElementTree.TreeBuilder):
    """Raises `InvalidInput` beyond the bounds, while the text is read."""

    def __init__(self) -> None:
        super().__init__()
        self._depth = self._elements = 0

    def start(self, tag: str, attrs: dict[str, str], /) -> ElementTree.Element:
        self._depth += 1
        self._elements += 1
        if self._depth > DEEPEST_XML:
            raise InvalidInput(f"deeper than {DEEPEST_XML} levels")
        if self._elements > MOST_ELEMENTS:
            raise InvalidInput(f"more than {MOST_ELEMENTS} elements")
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> ElementTree.Element:
        self._depth -= 1
        return super().end(tag)

    def doctype(self, name: str, pubid: str | None, system: str | None) -> NoReturn:
        """Refuse entities, which are defined here, as a few lines of them stand for gigabytes."""
        raise InvalidInput("a <!DOCTYPE> is not read; remove it")


def read_xml_text(path: Path) -> str:
    """Read the text of an XML file in the encoding that it declares, in UTF-8 or UTF-16 where it
    declares none.

    Raises `OSError`, and `InvalidInput` in one line for what is no file, no text in that encoding
    or too large.
    """
    content = _content(path, LARGEST_XML)
    declared = _ENCODING.match(content)
    if declared:
        encoding = declared[1].decode()
    else:
        encoding = "UTF-16" if content[:2] in (BOM_UTF16_LE, BOM_UTF16_BE) else "UTF-8"
    return _decoded(content, encoding)


def read_xml(path: Path | str) -> ElementTree.Element:
    """Read the root element of a file.

    Raises `OSError`, and `InvalidInput` in one line for what is no file, no XML or beyond the
    bounds.
    """
    parser = ElementTree.XMLParser(target=_Bounded())
    try:
        parser.feed(read_xml_text(Path(path)))
        root: ElementTree.Element = parser.close()
    except ElementTree.ParseError as error:
        raise InvalidInput(f"the XML is broken ({error})") from None
    return root


# YAML as plain values: bounded in size, depth and number, so that no file takes long or much
# memory.


class BoundedLoader(yaml.SafeLoader):
    """Raises `yaml.YAMLError` beyond the bounds, before values are built."""

    most_values = MOST_VALUES

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = self._values = 0
        self._sizes: dict[int, int] = {}
        """How many values a node with an anchor stands for."""

    def compose_node(self, parent: Node | None, index: Any) -> Node | None:
        """Compose one value with all that is in it. Raises `ComposerError` beyond the bounds."""
        alias = self.check_event(AliasEvent)
        event = self.peek_event()
        n_before = self._values
        self._require(self._depth < DEEPEST_YAML, f"deeper than {DEEPEST_YAML} levels", event)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        if alias:
            self._require(id(node) in self._sizes, "a value that contains itself", event)
            self._values += self._sizes[id(node)]
        else:
            self._values += 1
            self._sizes[id(node)] = self._values - n_before
        self._require(
            self._values <= self.most_values, f"more than {self.most_values} values", event
        )
        if isinstance(node, ScalarNode) and node.tag == _INTEGER:
            text = f"a number of {len(node.value)} characters; at most {_LONGEST_NUMBER} are read"
            self._require(len(node.value) <= _LONGEST_NUMBER, text, event)
        return node

    @staticmethod
    def _require(is_allowed: bool, text: str, event: Any) -> None:
        if not is_allowed:
            raise ComposerError(None, None, text, event.start_mark)


def read_yaml(path: Path | str, loader: Any = BoundedLoader) -> object:
    """Read the content of a file. Raises `OSError`, or `ValueError` in one line for what is no YAML
    or beyond the bounds.
    """
    text = read_text(Path(path), LARGEST_YAML)
    try:
        return deepcopy(_parsed(text, loader))
    except (
        yaml.YAMLError,
        ValueError,
        TypeError,
        OverflowError,
        AttributeError,
        LookupError,
    ) as error:
        # The constructors of PyYAML raise the latter for a date such as 2001-99-99.
        raise ValueError(" ".join(f"not valid YAML: {error}".split())[:400]) from None


def read_yaml_as(path: Path, model: type[_M]) -> _M:
    """Read the content of a file as a model. Raises `InvalidInput` in one line, with the file's
    name, for what is none.
    """
    try:
        return model.model_validate(read_yaml(path))
    except (OSError, ValueError) as error:
        if isinstance(error, ValidationError):
            text = one_line(error, model)
        else:
            text = str(error)
        raise InvalidInput(f"{path}: {text}") from None
