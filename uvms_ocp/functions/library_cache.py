"""The folder that compiled libraries are kept in: the user's own, writable by nobody else, on a disk that runs programs."""

from __future__ import annotations

import os
import stat
import sys
import tempfile
from pathlib import Path


def cache_folder() -> tuple[Path | None, str]:
    """The first folder that can be used, made if need be; None with the reason why the last one cannot.

    ``UVMS_OCP_CACHE`` where it is set. Otherwise inside the user's cache, and where there is none, as without a home or
    with one that is read-only, a folder of the user among the temporary ones.
    """
    reason = ""
    for folder in _candidates():
        reason = _problem(folder)
        if not reason:
            return folder, ""
    return None, reason


def _candidates() -> list[Path]:
    given = os.environ.get("UVMS_OCP_CACHE")
    if given:
        return [Path(given)]
    bases = (os.environ.get("XDG_CACHE_HOME", ""), _below_home(".cache"))
    base = next((base for base in bases if os.path.isabs(base)), None)
    user = os.getuid() if sys.platform != "win32" else "user"
    return [*([Path(base) / "uvms_ocp"] if base else []), Path(tempfile.gettempdir()) / f"uvms_ocp-{user}"]


def _below_home(name: str) -> str:
    # Without HOME and an entry of the user it stays "~", which is no place.
    return os.path.join(os.environ.get("HOME", os.path.expanduser("~")), name)


def _problem(folder: Path) -> str:
    """Why the folder cannot be used; empty where it can."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.lstat() if folder.parent == Path(tempfile.gettempdir()) else folder.stat()
        return _unsafe(folder, status)
    except OSError as error:
        return f"cache {folder} cannot be used ({error.strerror})"


def _unsafe(folder: Path, status: os.stat_result) -> str:
    """A library that others can replace must not be loaded."""
    foreign = sys.platform != "win32" and status.st_uid != os.getuid()
    if foreign or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return f"cache {folder} can be written by others"
    if not os.access(folder, os.W_OK | os.X_OK):
        return f"cache {folder} cannot be used (read-only)"
    if sys.platform == "linux" and os.statvfs(folder).f_flag & os.ST_NOEXEC:
        return f"cache {folder} cannot be used (mounted noexec)"
    return ""
