"""Replace all results of a command in a folder at once: claimed, locked and checked before the
work, whole or as before after it.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from uvms_ocp.errors import InvalidInput, OutputError, UvmsError
from uvms_ocp.model_errors import FileModel
from uvms_ocp.record.durable_files import (
    discard,
    locked,
    remove_empty,
    replacing,
    sync_folders,
    sync_tree,
    write_durably,
)
from uvms_ocp.record.manifest import (
    STORE,
    Manifest,
    fingerprint,
    is_same,
    names_below,
    parents_of,
    read_as,
    require_inside,
    require_own_files,
)

RUNNING = f"{STORE}/running"
"""Folder of the rows of a run that goes on, or that was cut off."""
RECORD = "record.npz"
"""File of the record of a run or of a plan."""


@contextmanager
def claim_folder(target: Path, names: Collection[str]) -> Iterator[Replacement]:
    """Claim the folder `target` for one command that may write files of these `names`, such as
    ``figures/path.png``.

    Completes or undoes first what a command that was cut off left. Raises `InvalidInput` for what
    stands in the way, and `OutputError` where the folder cannot be written or another command is at
    it: before the work begins.
    """
    replacement = Replacement(target=target)
    with ExitStack() as stack:
        with as_output_errors(target):
            new_folders = [folder for folder in (target, *target.parents) if not folder.exists()]
            stack.callback(remove_empty, new_folders)
            target.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked(replacement.store))
            replacement.recover()
            require_own_files(target, names, replacement.manifest())
        yield replacement


def recover_folder(folder: Path) -> None:
    """Complete or undo, before `folder` is read, what a command that was cut off left there.

    Raises `OutputError` where that cannot be done, or is being done, and `InvalidInput` for what
    stands in the way.
    """
    replacement = Replacement(target=folder)
    if not replacement.is_unfinished():
        return
    try:
        with as_output_errors(folder), locked(replacement.store):
            replacement.recover()
    except OutputError:
        # New files that wait beside complete old ones do not matter to a reader.
        if replacement.is_partly_replaced():
            raise


@contextmanager
def as_output_errors(target: Path, advice: str = "choose another folder") -> Iterator[None]:
    """Raise what the system refuses in the block as an `OutputError` of a file or folder; errors of
    ours pass.
    """
    try:
        yield
    except UvmsError:
        raise
    except OSError as error:
        reason = error.strerror or " ".join(str(error).split())
        raise OutputError(f"{target}: cannot write there ({reason}); {advice}") from error


@contextmanager
def whole_file(path: Path, advice: str = "choose another place") -> Iterator[BinaryIO]:
    """Yield an empty file that takes the place of `path` as `replacing` has it. Raises
    `OutputError` where the disk refuses.
    """
    with as_output_errors(path, advice), replacing(path) as file:
        yield file


class Journal(FileModel, strict=True):
    """Contents of the folder before and after a replacement."""

    before: Manifest
    after: Manifest


class Replacement:
    """Replace the files of `target` as a whole. All methods are for the one process that holds the
    lock.
    """

    def __init__(self, target: Path) -> None:
        self.target = target
        self.store = target / STORE
        """Folder of all that is not a result."""
        self.new = self.store / "new"
        """Folder in which new files wait."""
        self._old = self.store / "old"
        """Folder in which old ones are kept."""
        self._manifest = self.store / "manifest.json"
        """Our files in the target, as a `Manifest`."""
        self._journal = self.store / "journal.json"
        """The replacement that goes on, as a `Journal`."""
        self._undoing = self.store / "undoing.json"
        """The journal of one that is being undone."""

    def manifest(self) -> Manifest:
        """Return the manifest of what is there. Raises `InvalidInput` for one that cannot be
        read.
        """
        return read_as(Manifest, self._manifest) or Manifest()

    @contextmanager
    def staged(self, keep: Iterable[str] = ()) -> Iterator[Path]:
        """Give an empty folder; the files written there then take the place of all earlier ones of
        ours.

        keep: names of earlier ones that stay beside them. On any error the folder is as before.
        Raises `OutputError` where the disk refuses, and `InvalidInput` for what has come to stand
        in the way.
        """
        try:
            with as_output_errors(self.target):
                self.new.mkdir()
                for name in keep:
                    shutil.copyfile(self.target / name, self.new / name)
                yield self.new
                self.commit()
        except BaseException:
            if not self.is_partly_replaced():
                discard(self.new)
            raise

    def written(self) -> list[Path]:
        """Return the files of ours that are there. Raises `InvalidInput` for a damaged manifest."""
        return [self.target / name for name in sorted(self.manifest().files)]

    def is_unfinished(self) -> bool:
        """Return whether a command was cut off, or is at it."""
        return self.is_partly_replaced() or any(path.exists() for path in self._remains())

    def is_partly_replaced(self) -> bool:
        """Return whether some files may be old and others new."""
        return self._journal.exists() or self._undoing.exists()

    def commit(self) -> None:
        """Put the new files into their places and remove the old ones that have no successor.

        Raises `InvalidInput` for what stands in the way and `OSError` where the disk refuses, with
        all as it was before.
        """
        manifest = self.manifest()
        names = names_below(self.new)
        require_own_files(self.target, names, manifest)
        # What the user removed is not ours any more.
        old_files = {name: old for name, old in manifest.files.items() if self._is_there(name)}
        new_files = {name: fingerprint(self.new / name) for name in names}
        our_folders = set[str]()
        for folder in parents_of(names):
            if folder in manifest.folders or not self._is_there(folder):
                our_folders.add(folder)
        before = manifest.model_copy(update={"files": old_files})
        after = Manifest(files=new_files, folders=frozenset(our_folders))
        journal = Journal(before=before, after=after)
        sync_tree(self.new)
        write_durably(self._journal, journal.model_dump_json())
        self._complete_or_undo(journal)
        with suppress(OSError):  # which the next command does
            self._remove_folders(journal)
            self._clear()

    def recover(self) -> None:
        """Complete the replacement of a command that was cut off, or undo it where the disk
        refuses; remove what it left.

        Raises `InvalidInput` for what stands in the way, and `OSError` where that or the removal
        fails.
        """
        undoing = read_as(Journal, self._undoing)
        if undoing is not None:
            self._undo(undoing)
        else:
            journal = read_as(Journal, self._journal)
            if journal is not None:
                if self.manifest() != journal.after or names_below(self.new):
                    self._complete_or_undo(journal)
                self._remove_folders(journal)
        self._clear()

    def _complete_or_undo(self, journal: Journal) -> None:
        """Put the new files into their places; raise `OSError` where the disk refuses, with the old
        ones back in theirs.
        """
        try:
            self._complete(journal)
        except OSError:
            os.replace(self._journal, self._undoing)
            self._undo(journal)
            with suppress(OSError):
                self._clear()
            raise

    def _clear(self) -> None:
        """Remove the journal, then all that waits or was kept."""
        for path in (self._journal, self._undoing):
            path.unlink(missing_ok=True)
        sync_folders([self.store])
        for path in self._remains():
            discard(path)
        if self.is_unfinished():
            raise OSError(f"{self.store} cannot be emptied")

    def _complete(self, journal: Journal) -> None:
        """Put the new files that still wait into their places, and keep the old ones."""
        before = journal.before
        after = journal.after
        self._require_unchanged(journal)
        for name in after.files:
            # The old file stays in its place until the new one takes it, so that a reader always
            # finds one.
            if (self.new / name).exists():
                place = self.target / name
                place.parent.mkdir(parents=True, exist_ok=True)
                self._keep(name)
                os.replace(self.new / name, place)
        for name, expected in before.files.items():
            if name not in after.files and is_same(self.target / name, expected):
                self._keep(name)
                (self.target / name).unlink(missing_ok=True)
        sync_folders([self.target, *(self.target / name for name in parents_of(after.files))])
        write_durably(self._manifest, after.model_dump_json(indent=1))

    def _remove_folders(self, journal: Journal) -> None:
        """Remove folders last: to undo this could take room that a full disk does not have."""
        remove_empty(self.target / name for name in journal.before.folders - journal.after.folders)

    def _keep(self, name: str) -> None:
        """Give the old file a second name, or where the file system has no links, another."""
        place = self.target / name
        copy = self._old / name
        if copy.exists() or not place.exists():
            return
        copy.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(place, copy)
        except OSError:
            os.replace(place, copy)

    def _undo(self, journal: Journal) -> None:
        """Put the old files back into their places."""
        before = journal.before
        after = journal.after
        require_inside(self.target, [*before.files, *after.files])
        for name, expected in after.files.items():
            if name not in before.files and is_same(self.target / name, expected):
                (self.target / name).unlink()
        for name in before.files:
            if (self._old / name).exists():
                os.replace(self._old / name, self.target / name)
        remove_empty(self.target / name for name in after.folders - before.folders)
        sync_folders([self.target, *(self.target / name for name in parents_of(before.files))])

    def _require_unchanged(self, journal: Journal) -> None:
        """Raise `InvalidInput` where the place of a file that still waits was taken while nobody
        was at it.
        """
        before = journal.before.files
        after = journal.after.files
        require_inside(self.target, [*before, *after])
        for name in after:
            place = self.target / name
            is_waiting = (self.new / name).exists()
            if is_waiting and self._is_there(name) and not is_same(place, before.get(name)):
                raise InvalidInput(
                    f"{place}: in the way of a file that a command cut off is to put there; move it"
                    " away"
                )

    def _remains(self) -> list[Path]:
        """List what a finished command leaves nothing of."""
        return [self.new, self._old, *self.store.glob("*.tmp")]

    def _is_there(self, name: str) -> bool:
        return os.path.lexists(self.target / name)
