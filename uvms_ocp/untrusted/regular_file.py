"""The bytes of a file that is one: no device without end, and no pipe that waits for its writer."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from uvms_ocp.exceptions import InvalidInput

_READ: ContextVar[list[Path] | None] = ContextVar("files_read", default=None)


@contextmanager
def files_read() -> Iterator[list[Path]]:
    """Inside, the list that is given grows by every file that is read here: what the results depend on."""
    found: list[Path] = []
    token = _READ.set(found)
    try:
        yield found
    finally:
        _READ.reset(token)


def tell_read(path: Path) -> None:
    """That a file is read, also one that others open."""
    found = _READ.get()
    if found is not None:
        found.append(path.resolve())


def require_regular(path: Path) -> None:
    """Raise `InvalidInput` for a folder, a device or a pipe; what does not exist is for `open` to tell."""
    if path.exists() and not path.is_file():
        raise InvalidInput("no file but a folder or a device")


def read_text(path: Path, largest: int) -> str:
    """The text of a file of at most ``largest`` [B].

    Raises `OSError`, and `InvalidInput` in one line for what is no file, larger, or no text in UTF-8.
    """
    require_regular(path)
    tell_read(path)
    with path.open("rb") as file:
        content = file.read(largest + 1)
    if len(content) > largest:
        raise InvalidInput(f"larger than {largest >> 20} MB")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InvalidInput(f"no text in UTF-8: {error.reason} at byte {error.start}") from None
