"""Write files that survive a loss of power, and lock a folder for one process."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from uvms_ocp.errors import InvalidInput, OutputError

_MAX_ATTEMPTS = 1000  # to get hold of a lock that another process removes at the same moment


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Yield an empty file that takes the place of `path` as the block ends, on the disk: it is
    found whole, old or new, at any moment.

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
    """Replace a small file by a text, as `replacing` does. Raises `OSError`, with the old file in
    place.
    """
    with replacing(path) as file:
        file.write(text.encode())


def sync_tree(root: Path) -> None:
    """Bring every file and folder below `root`, and itself, to the disk. Raises `OSError` where a
    file does not get there.
    """
    for folder, _, names in os.walk(root):
        for name in names:
            # For writing, as Windows flushes no other descriptors.
            _sync(os.path.join(folder, name), os.O_RDWR)
        sync_folders([Path(folder)])


def sync_folders(folders: Iterable[Path]) -> None:
    """Bring names to the disk, where the system can open a folder and the file system can flush
    it.
    """
    for folder in folders:
        with suppress(OSError):
            _sync(folder, os.O_RDONLY)


def _sync(place: str | Path, mode: int) -> None:
    descriptor = os.open(place, mode)
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


@contextmanager
def locked(store: Path) -> Iterator[None]:
    """Hold the lock of a store for one process, which is made where there is none, and removed
    where it ends up with nothing but the lock; the system frees the lock of a process that is
    killed.

    Raises `OutputError` while another process holds it, `InvalidInput` for a store that is a link,
    and `OSError` where it cannot be written.
    """
    if store.is_symlink():
        raise InvalidInput(f"{store}: a link, which is not followed; remove it")
    descriptor = _acquired(store)
    try:
        yield
    finally:
        _release(store, descriptor)


def _acquired(store: Path) -> int:
    lock = store / "lock"
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
    # A process that lets go may remove store and lock between two of these steps.
    for _ in range(_MAX_ATTEMPTS):
        store.mkdir(exist_ok=True)
        try:
            descriptor = os.open(lock, flags, 0o666)
        except FileNotFoundError:
            continue
        try:
            _lock(descriptor, store)
            if os.path.samestat(os.fstat(descriptor), os.stat(lock)):
                return descriptor
        except FileNotFoundError:
            pass
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)
    raise _busy(store)


def _lock(descriptor: int, store: Path) -> None:
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError) as error:
        raise _busy(store) from error


def _busy(store: Path) -> OutputError:
    return OutputError(
        f"{store.parent}: another command writes there; wait for it or choose another folder"
    )


def _release(store: Path, descriptor: int) -> None:
    removes_open_files = sys.platform != "win32"
    if not removes_open_files:
        os.close(descriptor)
    with suppress(OSError):
        if os.listdir(store) == ["lock"]:
            os.unlink(store / "lock")
            os.rmdir(store)
    if removes_open_files:
        os.close(descriptor)
