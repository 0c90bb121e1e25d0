"""The replacement of all files of a folder, in steps that can be completed or undone from wherever they were cut off."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.output.durable import discard, remove_empty, sync_folders, sync_tree, write_durably
from uvms_ocp.output.foreign import require_inside, require_ours
from uvms_ocp.output.manifest import STORE, Manifest, is_same, manifest_of, names_below, parents_of, read_as


class Journal(BaseModel):
    """What belongs into the folder before and after a replacement."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")

    before: Manifest
    after: Manifest


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Replacement:
    """Of the files of `target`. All methods are for the one process that holds the lock."""

    target: Path

    @property
    def store(self) -> Path:
        return self.target / STORE

    @property
    def new(self) -> Path:
        """Where the new files wait."""
        return self.store / "new"

    def manifest(self) -> Manifest:
        """Of what is there. Raises `InvalidInput` for one that cannot be read."""
        return read_as(Manifest, self._manifest) or Manifest()

    def is_left_over(self) -> bool:
        """Whether a command was cut off, or is at it."""
        return any(path.exists() for path in (self._journal, self._undoing, *self._remains()))

    def is_begun(self) -> bool:
        """Whether some files may be old and others new."""
        return self._journal.exists() or self._undoing.exists()

    def commit(self) -> None:
        """Put the new files into their places and remove the old ones that have no successor.

        Raises `InvalidInput` for what stands in the way and `OSError` where the disk refuses, with all as it was before.
        """
        manifest, names = self.manifest(), names_below(self.new)
        require_ours(self.target, names, manifest)
        after = manifest_of(self.new, names)
        # What the user removed is not ours any more.
        before = manifest.model_copy(update={"files": {n: f for n, f in manifest.files.items() if self._is_there(n)}})
        needed = parents_of(names)
        made = {folder for folder in needed if not self._is_there(folder)} | (needed & before.folders)
        sync_tree(self.new)
        journal = Journal(before=before, after=after.model_copy(update={"folders": frozenset(made)}))
        write_durably(self._journal, journal.model_dump_json())
        self._complete_or_undo(journal)
        with suppress(OSError):  # which the next command does
            self._remove_folders(journal)
            self._clear()

    def recover(self) -> None:
        """Complete the replacement of a command that was cut off, or undo it where the disk refuses; remove what it left.

        Raises `InvalidInput` for what stands in the way, and `OSError` where that or the removal fails.
        """
        if (undoing := read_as(Journal, self._undoing)) is not None:
            self._undo(undoing)
        elif (journal := read_as(Journal, self._journal)) is not None:
            if self.manifest() != journal.after or names_below(self.new):
                self._complete_or_undo(journal)
            self._remove_folders(journal)
        self._clear()

    def _complete_or_undo(self, journal: Journal) -> None:
        try:
            self._complete(journal)
        except OSError:
            os.replace(self._journal, self._undoing)
            self._undo(journal)
            with suppress(OSError):
                self._clear()
            raise

    def _clear(self) -> None:
        for path in (self._journal, self._undoing):
            path.unlink(missing_ok=True)
        sync_folders([self.store])
        for path in self._remains():
            discard(path)
        if self.is_left_over():
            raise OSError(f"{self.store} cannot be emptied")

    def _complete(self, journal: Journal) -> None:
        before, after = journal.before, journal.after
        self._require_unchanged(journal)
        for name in after.files:
            self._install(name)
        for name, known in before.files.items():
            if name not in after.files and is_same(self.target / name, known):
                self._keep(name)
                (self.target / name).unlink(missing_ok=True)
        sync_folders([self.target, *(self.target / name for name in parents_of(after.files))])
        write_durably(self._manifest, after.model_dump_json(indent=1))

    def _remove_folders(self, journal: Journal) -> None:
        """Not earlier: to undo this could take room that a full disk does not have."""
        remove_empty(self.target / name for name in journal.before.folders - journal.after.folders)

    def _install(self, name: str) -> None:
        """The old file stays in its place until the new one takes it, so that a reader always finds one."""
        if (self.new / name).exists():
            place = self.target / name
            place.parent.mkdir(parents=True, exist_ok=True)
            self._keep(name)
            os.replace(self.new / name, place)

    def _keep(self, name: str) -> None:
        """A second name for the old file, or where the file system has no links, another."""
        place, kept = self.target / name, self._old / name
        if kept.exists() or not place.exists():
            return
        kept.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(place, kept)
        except OSError:
            os.replace(place, kept)

    def _undo(self, journal: Journal) -> None:
        before, after = journal.before, journal.after
        require_inside(self.target, [*before.files, *after.files])
        for name, known in after.files.items():
            if name not in before.files and is_same(self.target / name, known):
                (self.target / name).unlink()
        for name in before.files:
            if (self._old / name).exists():
                os.replace(self._old / name, self.target / name)
        remove_empty(self.target / name for name in after.folders - before.folders)
        sync_folders([self.target, *(self.target / name for name in parents_of(before.files))])

    def _require_unchanged(self, journal: Journal) -> None:
        """Raise `InvalidInput` where the place of a file that still waits was taken while nobody was at it."""
        before, after = journal.before.files, journal.after.files
        require_inside(self.target, [*before, *after])
        for name in after:
            place = self.target / name
            if (self.new / name).exists() and self._is_there(name) and not is_same(place, before.get(name)):
                raise InvalidInput(
                    f"{place}: in the way of a file that a command cut off is to put there; move it away"
                )

    def _remains(self) -> list[Path]:
        return [self.new, self._old, *self.store.glob("*.tmp")]

    def _is_there(self, name: str) -> bool:
        return os.path.lexists(self.target / name)

    @property
    def _manifest(self) -> Path:
        return self.store / "manifest.json"

    @property
    def _journal(self) -> Path:
        return self.store / "journal.json"

    @property
    def _undoing(self) -> Path:
        return self.store / "undoing.json"

    @property
    def _old(self) -> Path:
        return self.store / "old"
