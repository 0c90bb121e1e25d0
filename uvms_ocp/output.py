"""A folder of results that appears whole or not at all."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from uvms_ocp.exceptions import OutputError


@contextmanager
def staged_folder(target: Path, *, earlier: Collection[str] = ()) -> Iterator[Path]:
    """Give a staging folder beside `target`; on success its entries replace those of the same name in `target`.

    earlier: files, relative to `target`, that an earlier result may have left; those not written anew are removed on
    success, so that the folder tells of one result only. Other files stay, as `target` may be a folder in use.

    On any error the staging folder is removed and `target` is as before. Raises `OutputError` before the work begins
    where `target` cannot be written.
    """
    created = [folder for folder in (target, *target.parents) if not folder.exists()]
    staging = _make_staging(target)
    try:
        yield staging
        outdated = [target / name for name in earlier if not (staging / name).exists()]
        for entry in sorted(staging.iterdir()):
            _replace(entry, target / entry.name)
        _remove_files(outdated)
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
        raise OutputError(f"{target}: cannot write there ({error.strerror}); choose another folder") from error


def _replace(entry: Path, destination: Path) -> None:
    if destination.is_dir():
        shutil.rmtree(destination)
    entry.replace(destination)


def _remove_files(files: list[Path]) -> None:
    """Remove the files there are, and the folders that this leaves empty."""
    present = [file for file in files if file.is_file()]
    for file in present:
        file.unlink()
    _remove_empty(list({file.parent: None for file in present}))


def _remove_empty(created: list[Path]) -> None:
    for folder in created:
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
