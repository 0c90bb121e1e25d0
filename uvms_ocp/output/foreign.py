"""What stands in the way of writing: files of others, changed files, links that lead out of the folder."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable
from pathlib import Path

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.output.manifest import Fingerprint, Manifest, is_same, parents_of

_ADVICE = "move it away or choose another folder"


def require_ours(target: Path, names: Iterable[str], manifest: Manifest) -> None:
    """Raise `InvalidInput`, naming the first thing in `target` that keeps us from writing `names`.

    All that the manifest lists has to be as we left it, as what is not written anew is removed.
    """
    wanted = {*names, *manifest.files}
    require_inside(target, wanted)
    for name in sorted(wanted):
        _require_free(target / name, manifest.files.get(name))


def require_inside(target: Path, names: Iterable[str]) -> None:
    """Raise `InvalidInput` where the way to one of `names` leads out of `target`, is none or cannot be written."""
    _require_writable(target)
    for folder in sorted(parents_of(names)):
        _require_real_folder(target / folder, target)


def _require_real_folder(folder: Path, target: Path) -> None:
    status = _status(folder)
    if status is None:
        return
    if stat.S_ISLNK(status.st_mode):
        raise InvalidInput(f"{folder}: a link, which is not followed; {_ADVICE}")
    if not stat.S_ISDIR(status.st_mode):
        raise InvalidInput(f"{folder}: a file where a folder is to be; {_ADVICE}")
    if status.st_dev != target.stat().st_dev:
        raise InvalidInput(f"{folder}: on another disk than {target}; {_ADVICE}")
    _require_writable(folder)


def _require_writable(folder: Path) -> None:
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InvalidInput(f"{folder}: cannot write there (read-only folder); choose another folder")


def _require_free(place: Path, known: Fingerprint | None) -> None:
    status = _status(place)
    if status is None:
        return
    if known is None:
        raise InvalidInput(f"{place}: not written by an earlier command; {_ADVICE}")
    if not is_same(place, known):
        raise InvalidInput(f"{place}: changed since an earlier command wrote it; {_ADVICE}")
    if not status.st_mode & stat.S_IWUSR:
        raise InvalidInput(f"{place}: read-only; make it writable, {_ADVICE}")


def _status(path: Path) -> os.stat_result | None:
    try:
        return os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return None
