"""One command at a time in a folder; the system frees the lock of a process that is killed."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from uvms_ocp.exceptions import InvalidInput, OutputError

_BEGIN_ANEW = 1000


@contextmanager
def locked(store: Path) -> Iterator[None]:
    """Hold the lock of a store, which is made where there is none, and removed where it ends up with nothing but the lock.

    Raises `OutputError` while another process holds it, `InvalidInput` for a store that is a link, and `OSError` where it
    cannot be written.
    """
    if store.is_symlink():
        raise InvalidInput(f"{store}: a link, which is not followed; remove it")
    descriptor = _acquired(store)
    try:
        yield
    finally:
        _release(store, descriptor)


def _acquired(store: Path) -> int:
    for _ in range(_BEGIN_ANEW):  # a process that lets go may remove store and lock between two of our steps
        store.mkdir(exist_ok=True)
        try:
            descriptor = os.open(store / "lock", os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
        except FileNotFoundError:
            continue
        try:
            _lock(descriptor, store)
            if os.path.samestat(os.fstat(descriptor), os.stat(store / "lock")):
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
    return OutputError(f"{store.parent}: another command writes there; wait for it or choose another folder")


def _release(store: Path, descriptor: int) -> None:
    if sys.platform == "win32":  # which removes no open file
        os.close(descriptor)
    with suppress(OSError):
        if os.listdir(store) == ["lock"]:
            os.unlink(store / "lock")
            os.rmdir(store)
    if sys.platform != "win32":
        os.close(descriptor)
