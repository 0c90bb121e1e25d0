"""The bytes of a file that is one: no device without end, and no pipe that waits for its writer."""

from __future__ import annotations

from pathlib import Path

from uvms_ocp.exceptions import InvalidInput


def require_regular(path: Path) -> None:
    """Raise `InvalidInput` for a folder, a device or a pipe; what does not exist is for `open` to tell."""
    if path.exists() and not path.is_file():
        raise InvalidInput("no file but a folder or a device")


def read_text(path: Path, largest: int) -> str:
    """The text of a file of at most ``largest`` [B].

    Raises `OSError`, and `InvalidInput` in one line for what is no file, larger, or no text in UTF-8.
    """
    require_regular(path)
    with path.open("rb") as file:
        content = file.read(largest + 1)
    if len(content) > largest:
        raise InvalidInput(f"larger than {largest >> 20} MB")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InvalidInput(f"no text in UTF-8: {error.reason} at byte {error.start}") from None
