"""Writing so that a loss of power finds it on the disk, and removing what may be gone."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """An empty file that takes the place of `path` as the block ends, on the disk: it is found whole, old or new, at any moment.

    Raises `OSError`, with the old file in place.
    """
    fresh = path.with_name(path.name + ".tmp")
    try:
        with fresh.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(fresh, path)
    except OSError:
        discard(fresh)
        raise
    sync_folders([path.parent])


def write_durably(path: Path, text: str) -> None:
    """Replace a small file by a text, as `replacing` does. Raises `OSError`, with the old file in place."""
    with replacing(path) as file:
        file.write(text.encode())


def sync_tree(root: Path) -> None:
    """Bring every file and folder below `root`, and itself, to the disk. Raises `OSError` where a file does not get there."""
    for folder, _, names in os.walk(root):
        for name in names:
            # For writing, as Windows flushes no other descriptors.
            descriptor = os.open(os.path.join(folder, name), os.O_RDWR)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
        sync_folders([Path(folder)])


def sync_folders(folders: Iterable[Path]) -> None:
    """Bring names to the disk, where the system can open a folder and the file system can flush it."""
    for folder in folders:
        with suppress(OSError):
            descriptor = os.open(folder, os.O_RDONLY)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)


def discard(path: Path) -> None:
    """Remove a file or a folder with all that is in it, as far as that goes."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


def remove_empty(folders: Iterable[Path]) -> None:
    """Remove those of the folders that are there and hold nothing, the deepest first."""
    for folder in sorted(folders, key=lambda path: len(path.parts), reverse=True):
        with suppress(OSError):
            folder.rmdir()
