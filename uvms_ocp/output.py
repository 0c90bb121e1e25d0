"""A folder of results that appears whole or not at all."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from uvms_ocp.exceptions import OutputError


@contextmanager
def staged_folder(target: Path) -> Iterator[Path]:
    """Give a staging folder beside `target`; on success its entries replace those of the same name in `target`.

    On any error the staging folder is removed and `target` is as before. Raises `OutputError` before the work begins
    where `target` cannot be written.
    """
    created = [folder for folder in (target, *target.parents) if not folder.exists()]
    staging = _make_staging(target)
    try:
        yield staging
        for entry in sorted(staging.iterdir()):
            _replace(entry, target / entry.name)
    except BaseException:
        shutil.rmtree(staging, ignore_errors=True)
        _remove_empty(created)
        raise
    staging.rmdir()


def _make_staging(target: Path) -> Path:
    try:
        target.mkdir(parents=True, exist_ok=True)
        return Path(tempfile.mkdtemp(prefix=".partial-", dir=target))
    except OSError as error:
        raise OutputError(
            f"{target}: cannot write there ({error.strerror}); choose another folder with --out"
        ) from error


def _replace(entry: Path, destination: Path) -> None:
    if destination.is_dir():
        shutil.rmtree(destination)
    entry.replace(destination)


def _remove_empty(created: list[Path]) -> None:
    for folder in created:
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
