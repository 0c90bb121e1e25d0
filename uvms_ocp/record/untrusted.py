"""Read files that anyone may have written, within bounds: their bytes, text and JSON, with every
error in one line.

`array_file`, `xml_file` and `yaml_file` read the formats.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from uvms_ocp.errors import InvalidInput, UvmsError

DENSEST = 400
"""[B/B] Largest size of all arrays of a file over that of the file, where they are more than `SMALL`.

It refuses what a few bytes unpack to, and no run for its length, as a longer run makes a larger
file. Motion packs 2 to 4 times. A robot that stands still packs 144 times and not much more: every
tick has its time and two readings of a clock, 8 B after packing, beside 2 kB that hardly take any.
Zeros alone pack 1,032 times, by other methods of the archive 10,000.
"""
SMALL = 64 << 20
"""[B] Size of arrays that is read however few bytes they come from, as it fits into any memory."""

_FILES_READ: ContextVar[list[Path] | None] = ContextVar("record_files_read", default=None)


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


def read_text(path: Path, largest: int) -> str:
    """Read the text of a file of at most ``largest`` [B].

    Raises `OSError`, and `InvalidInput` in one line for what is no file, larger, or no text in
    UTF-8.
    """
    return decoded(read_bytes(path, largest), "UTF-8")


def read_bytes(path: Path, largest: int) -> bytes:
    """Read a file of at most ``largest`` [B], and note it for `record_files_read`.

    Raises `OSError`, and `InvalidInput` in one line for what is no file, or larger.
    """
    require_regular_file(path)
    note_file_read(path)
    with path.open("rb") as file:
        content = file.read(largest + 1)
    if len(content) > largest:
        raise InvalidInput(f"larger than {largest >> 20} MB")
    return content


def decoded(content: bytes, encoding: str) -> str:
    """Decode the text of a file. Raises `InvalidInput` for none, and for an unknown encoding."""
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as error:
        raise InvalidInput(f"no text in {encoding}: {error.reason} at byte {error.start}") from None
    except LookupError:
        raise InvalidInput(
            f"encoding {encoding!r}, which is not known; save the file as UTF-8"
        ) from None


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


def require_regular_file(path: Path) -> None:
    """Raise `InvalidInput` for a folder, a device without end or a pipe that waits for its writer;
    what does not exist is for `open` to tell.
    """
    if path.exists() and not path.is_file():
        raise InvalidInput("no file but a folder or a device")


@contextmanager
def record_files_read() -> Iterator[list[Path]]:
    """Yield a list that grows, inside, by every file that is read here: what the results depend
    on.
    """
    paths: list[Path] = []
    token = _FILES_READ.set(paths)
    try:
        yield paths
    finally:
        _FILES_READ.reset(token)


def note_file_read(path: Path) -> None:
    """Add a file to those of `record_files_read`, also one that other libraries open."""
    paths = _FILES_READ.get()
    if paths is not None:
        paths.append(path.resolve())
