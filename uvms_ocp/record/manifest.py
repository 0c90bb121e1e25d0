"""The files that a command wrote into a folder, by which they are known again, and what stands in
the way of replacing them: files of others, changed files, links that lead out of the folder.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, Field, ValidationError

from uvms_ocp.errors import InvalidInput, OutputError
from uvms_ocp.model_errors import FileModel, one_line

STORE = ".uvms_ocp"
"""Folder of ours in every folder that we write to."""

Model = TypeVar("Model", bound=BaseModel)

_ADVICE = "move it away or choose another folder"
"""Advice where a folder is in the way."""


def _inner(name: str) -> str:
    """Require a name that stays inside its folder, on every system."""
    parts = name.split("/")
    leads_out = not all(parts) or {".", "..", STORE} & set(parts)
    if leads_out or any(sign in name for sign in '\\:\0\n"'):
        raise ValueError("allowed: a path inside the folder, such as figures/path.png")
    return name


Name = Annotated[str, AfterValidator(_inner)]


class Fingerprint(FileModel, strict=True):
    """Digest of a file's contents."""

    size: int
    """Size [bytes]."""
    sha256: str


class Manifest(FileModel, strict=True):
    """The files that a command wrote, and the folders that it made for them."""

    version: Literal[1] = 1
    files: dict[Name, Fingerprint] = Field(default={})
    folders: frozenset[Name] = frozenset()


def read_as(kind: type[Model], path: Path) -> Model | None:
    """Read a file of `STORE`; None where there is none. Raises `InvalidInput` for one that we did
    not write so, `OutputError` for one that cannot be read.
    """
    try:
        return kind.model_validate_json(path.read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise OutputError(
            f"{path}: cannot read it ({error.strerror}); choose another folder"
        ) from error
    except ValidationError as error:
        text = f"{path}: damaged ({one_line(error, kind)})"
        raise InvalidInput(
            f"{text}; move its folder {STORE} and the results beside it away"
        ) from error


def parents_of(names: Iterable[str]) -> set[str]:
    """Return folders that files of these names need."""
    folders = set[str]()
    for name in names:
        for folder in PurePosixPath(name).parents:
            if folder.name:
                folders.add(str(folder))
    return folders


def names_below(root: Path) -> list[str]:
    """Return files, as a manifest names them."""
    files = [path for path in root.rglob("*") if path.is_file()]
    return sorted(path.relative_to(root).as_posix() for path in files)


def fingerprint(path: Path) -> Fingerprint:
    """Return the digest of the contents of a file. Raises `OSError` where it cannot be read."""
    with path.open("rb") as file:
        return Fingerprint(sha256=hashlib.file_digest(file, "sha256").hexdigest(), size=file.tell())


def is_same(path: Path, expected: Fingerprint | None) -> bool:
    """Return whether a regular file with those contents is there. Raises `OSError` where it cannot
    be read.
    """
    status = _status(path)
    if status is None or expected is None:
        return False
    if not stat.S_ISREG(status.st_mode) or status.st_size != expected.size:
        return False
    return fingerprint(path) == expected


def require_own_files(target: Path, names: Iterable[str], manifest: Manifest) -> None:
    """Raise `InvalidInput`, naming the first thing in `target` that keeps us from writing `names`.

    All that the manifest lists has to be as we left it, as what is not written anew is removed.
    """
    paths = {*names, *manifest.files}
    require_inside(target, paths)
    for name in sorted(paths):
        _require_free(target / name, manifest.files.get(name))


def require_inside(target: Path, names: Iterable[str]) -> None:
    """Raise `InvalidInput` where the way to one of `names` leads out of `target`, is none or cannot
    be written.
    """
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
        raise InvalidInput(
            f"{folder}: cannot write there (read-only folder); choose another folder"
        )


def _require_free(place: Path, expected: Fingerprint | None) -> None:
    status = _status(place)
    if status is None:
        return
    if expected is None:
        raise InvalidInput(f"{place}: not written by an earlier command; {_ADVICE}")
    if not is_same(place, expected):
        raise InvalidInput(f"{place}: changed since an earlier command wrote it; {_ADVICE}")
    if not status.st_mode & stat.S_IWUSR:
        raise InvalidInput(f"{place}: read-only; make it writable, {_ADVICE}")


def _status(path: Path) -> os.stat_result | None:
    try:
        return os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return None
