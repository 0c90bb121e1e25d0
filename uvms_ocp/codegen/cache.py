"""The folder that compiled libraries are kept in: the user's own, writable by nobody else, on a
disk that runs programs.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import monotonic, sleep, time

KEPT_NUMBERS = ".numbers"
"""Suffix of the files that tell in which library a function is, with its numbers, or kernels
are.
"""
HALF_MADE = "uvms-ocp-half-made-"
"""Prefix of folders in which something is made."""
_HASH = "[0-9a-f]" * 64
_PAUSE = 0.02  # [s] between looks whether it is our turn
_FORGOTTEN = 86400.0  # [s] after which nobody works on what is half made


def cache_folder() -> tuple[Path | None, str]:
    """Return the first folder that can be used, made if need be; None with the reason why the last
    one cannot.

    ``UVMS_OCP_CACHE`` where it is set. Otherwise inside the user's cache, and where there is none,
    as without a home or with one that is read-only, a folder of the user among the temporary ones.
    """
    reason = ""
    for folder in _candidates():
        reason = _problem(folder)
        if not reason:
            return folder, ""
    return None, reason


def cached_libraries(folder: Path) -> dict[Path, os.stat_result]:
    """Return the libraries of a cache folder, and the files of numbers of functions in them, by
    time of last use, latest first.
    """
    libraries = dict[Path, os.stat_result]()
    for suffix in (".so", KEPT_NUMBERS):
        for path in folder.glob(_HASH + suffix):
            with suppress(OSError):  # another process removes it
                libraries[path] = path.stat()
    return dict(sorted(libraries.items(), key=lambda pair: -pair[1].st_mtime))


def shrink_cache(folder: Path, max_size: float) -> dict[Path, os.stat_result]:
    """Remove the libraries used longest ago until at most `max_size` bytes are left; return what
    was removed.

    What processes that were killed a day ago have left half made is removed, too.
    """
    for path in (*folder.glob(f"{HALF_MADE}*"), *folder.glob(f"{_HASH}.lock")):
        with suppress(OSError):
            if time() - path.stat().st_mtime <= _FORGOTTEN:
                continue
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()
    total_size = 0
    removed = dict[Path, os.stat_result]()
    for path, status in cached_libraries(folder).items():
        total_size += status.st_size
        if total_size > max_size:
            with suppress(OSError):  # it is in use, or another process removes it
                path.unlink()
                removed[path] = status
                path.with_suffix(".sha256").unlink()
    return removed


def digest(data: bytes) -> str:
    """Return the hash by which a file of the cache is known."""
    return hashlib.sha256(data).hexdigest()


def _candidates() -> list[Path]:
    configured = os.environ.get("UVMS_OCP_CACHE")
    if configured:
        return [Path(configured)]
    # Without an entry of the user it stays "~", which is no place.
    home = os.environ.get("HOME", os.path.expanduser("~"))
    user_caches = (os.environ.get("XDG_CACHE_HOME", ""), os.path.join(home, ".cache"))
    folders = list[Path]()
    for user_cache in user_caches:
        if os.path.isabs(user_cache):
            folders.append(Path(user_cache) / "uvms_ocp")
            break
    user = os.getuid() if sys.platform != "win32" else "user"
    folders.append(Path(tempfile.gettempdir()) / f"uvms_ocp-{user}")
    return folders


def _problem(folder: Path) -> str:
    """Return why the folder cannot be used; empty where it can."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        is_temporary = folder.parent == Path(tempfile.gettempdir())
        # Among temporary folders a link may be anybody's.
        status = folder.lstat() if is_temporary else folder.stat()
        return _unsafe(folder, status)
    except OSError as error:
        return f"cache {folder} cannot be used ({error.strerror})"


def _unsafe(folder: Path, status: os.stat_result) -> str:
    """Return why libraries of a folder must not be loaded, or cannot be kept there; empty where
    they can.
    """
    foreign = sys.platform != "win32" and status.st_uid != os.getuid()
    if foreign or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return f"cache {folder} can be written by others"
    if not os.access(folder, os.W_OK | os.X_OK):
        return f"cache {folder} cannot be used (read-only)"
    if sys.platform == "linux" and os.statvfs(folder).f_flag & os.ST_NOEXEC:
        return f"cache {folder} cannot be used (mounted noexec)"
    return ""


@contextmanager
def turn_to_make(library: Path, seconds: float) -> Iterator[None]:
    """Let one process at a time make a library; the others find it then, or make it themselves
    after so many `seconds` [s].
    """
    if sys.platform == "win32":
        yield
        return
    import fcntl

    def is_ours() -> bool:
        with suppress(OSError):  # of disks without locks, where each makes its own
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                return False
        return True

    lock = library.with_suffix(".lock")
    ends = monotonic() + seconds
    with lock.open("w") as file:
        while not is_ours() and monotonic() < ends:
            sleep(_PAUSE)
        try:
            yield
        finally:
            lock.unlink(missing_ok=True)
            with suppress(OSError):
                # Closing lets go of nothing that a fork has open, too.
                fcntl.flock(file, fcntl.LOCK_UN)
