"""What a command of ours wrote into a folder, by which it is known again."""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from uvms_ocp.exceptions import InvalidInput, OutputError
from uvms_ocp.validation import one_line

STORE = ".uvms_ocp"  # in every folder that we write to
_CHUNK = 1 << 20


def _inner(name: str) -> str:
    """A name that stays inside its folder, on every system."""
    parts = name.split("/")
    if not all(parts) or {".", "..", STORE} & set(parts) or any(sign in name for sign in '\\:\0\n"'):
        raise ValueError("allowed: a path inside the folder, such as figures/path.png")
    return name


Name = Annotated[str, AfterValidator(_inner)]
Model = TypeVar("Model", bound=BaseModel)


class Fingerprint(BaseModel):
    """By which the contents of a file are known."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")

    size: int
    """[bytes]."""
    sha256: str


class Manifest(BaseModel):
    """The files that a command wrote, and the folders that it made for them."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")

    version: Literal[1] = 1
    files: dict[Name, Fingerprint] = {}
    folders: frozenset[Name] = frozenset()


def read_as(kind: type[Model], path: Path) -> Model | None:
    """A file of `STORE`; None where there is none. Raises `InvalidInput` for one that we did not write so, `OutputError`
    for one that cannot be read."""
    try:
        return kind.model_validate_json(path.read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise OutputError(f"{path}: cannot read it ({error.strerror}); choose another folder") from error
    except ValidationError as error:
        raise InvalidInput(
            f"{path}: damaged ({one_line(error, kind)}); move its folder {STORE} and the results beside it away"
        ) from error


def parents_of(names: Iterable[str]) -> set[str]:
    """Folders that files of these names need."""
    return {str(parent) for name in names for parent in PurePosixPath(name).parents if parent.name}


def names_below(root: Path) -> list[str]:
    """Files, as a manifest names them."""
    return sorted(path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file())


def manifest_of(root: Path, names: Iterable[str], folders: Iterable[str] = ()) -> Manifest:
    """Of files below `root`. Raises `OSError` for one that cannot be read."""
    return Manifest(files={name: fingerprint(root / name) for name in names}, folders=frozenset(folders))


def fingerprint(path: Path) -> Fingerprint:
    """Of the contents of a file. Raises `OSError` where it cannot be read."""
    digest, size = hashlib.sha256(), 0
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
            size += len(chunk)
    return Fingerprint(size=size, sha256=digest.hexdigest())


def is_same(path: Path, known: Fingerprint | None) -> bool:
    """Whether a regular file with those contents is there. Raises `OSError` where it cannot be read."""
    try:
        status = os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return False
    if known is None or not stat.S_ISREG(status.st_mode) or status.st_size != known.size:
        return False
    return fingerprint(path) == known
