"""A scenario or a list of variations by the code that makes it, with every file it read: built
again anywhere.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Literal

from pydantic import ValidationError

from uvms_ocp.errors import InvalidInput
from uvms_ocp.model_errors import FileModel, one_line
from uvms_ocp.record import durable_files, manifest, untrusted
from uvms_ocp.robot.loading import robots_folder
from uvms_ocp.scenario.cases import SCENARIOS
from uvms_ocp.scenario.own_code import forget_user_code, load_scenario, own_code, siblings

_PACKED = "uvms_ocp_robots/"  # names of files of our own robots
_PLACES = ("robot", "hydrodynamics", "loading")  # options that may be files


class _Identity(FileModel, strict=True):
    """JSON values of `CodeSource.identity`."""

    words: str
    attribute: Literal["scenario", "variations"]
    options: dict[str, Any]
    files: dict[manifest.Name, str]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CodeSource:
    """Words, options and files. Where the files are as they were, they are used in their place, and
    elsewhere a copy.
    """

    words: str
    """A name, ``file.py:name`` or ``package.module:name``."""
    attribute: str = "scenario"
    """Name to read from a file unless the words give one."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options, as on the command line."""
    root: str = ""
    """Folder that holds all files."""
    files: Mapping[str, bytes] = field(default_factory=dict)
    """Contents by the path below `root`."""

    @staticmethod
    def gathered(
        words: str, options: Mapping[str, Any] | None = None, attribute: str = "scenario"
    ) -> CodeSource:
        """Make it with the files that the code reads now. Raises what building it raises."""
        code = own_code(words, attribute)
        placed_options = dict(options or {})
        for name in _PLACES:
            if name in placed_options:
                placed_options[name] = _absolute(placed_options[name])
        source = CodeSource(
            words=_placed(words, Path.cwd()), attribute=attribute, options=placed_options
        )
        forget_user_code()
        with untrusted.record_files_read() as files_read:
            source.build()
        paths = set(files_read)
        if code is not None and code.file is not None:
            file = code.file.resolve()
            paths |= {file, *siblings(file.parent)}
        return replace(source, root=_common(paths), files=_contents(paths))

    def build(self) -> Any:
        """Build what the code defines: a `Scenario`, or whatever has the name of `attribute`.

        Raises `InvalidInput` for words that are no code, and what the code raises.
        """
        source = self.located()
        if self.attribute == "scenario":
            return load_scenario(source.words, source.options, SCENARIOS)
        code = own_code(source.words, self.attribute)
        if code is None:
            raise InvalidInput(
                f"{source.words!r} is no Python code; give FILE.py, FILE.py:NAME or"
                " PACKAGE.MODULE:NAME"
            )
        value = code.load()
        if callable(value):
            return value()
        return value

    def located(self) -> CodeSource:
        """Return it with words and options that point to files with the right contents on this
        machine.
        """
        if not self.files or _is_intact(Path(self.root), self.files):
            return self
        folder = _unpacked(self.digest(), tuple(self.files.items()))
        options = dict(self.options)
        for name in _PLACES:
            if name in options:
                options[name] = _each(options[name], partial(self._moved, folder=folder))
        return replace(self, words=self._moved(self.words, folder), options=options, files={})

    def digest(self) -> str:
        """Return the hash of all files."""
        return hashlib.sha256(repr(sorted(self.hashes().items())).encode()).hexdigest()

    def hashes(self) -> dict[str, str]:
        """Return the hash of each file."""
        return {
            name: hashlib.sha256(content).hexdigest()
            for name, content in sorted(self.files.items())
        }

    def identity(self) -> dict[str, Any]:
        """Return its identity, from which `restored` makes it: JSON values, paths below the root
        with ``./``.
        """
        options = {name: _each(value, self._below) for name, value in sorted(self.options.items())}
        return {
            "words": self._below(self.words),
            "attribute": self.attribute,
            "options": options,
            "files": self.hashes(),
        }

    @staticmethod
    def restored(identity: Mapping[str, Any], copies: Path) -> CodeSource:
        """Restore it from an `identity` and the copies of files in a folder.

        Raises `InvalidInput` for a changed copy, an identity that is none, and words that name a
        file without a copy.
        """
        root = str(copies.resolve())
        try:
            validated = _Identity.model_validate(identity)
        except ValidationError as error:
            raise InvalidInput(
                f"{copies}: not what a campaign keeps of it ({one_line(error, _Identity)})"
            ) from None
        code = own_code(validated.words)
        if code is not None and code.file is not None:
            name = code.file.as_posix().removeprefix("./")
            if name not in validated.files:
                raise InvalidInput(
                    f"{copies}: {validated.words[:80]!r} is not among its files; put back what was"
                )

        def placed(value: Any) -> Any:
            if isinstance(value, str) and value.startswith("./"):
                return os.path.join(root, value[2:])
            return value

        source = CodeSource(
            words=placed(identity["words"]),
            attribute=identity["attribute"],
            options={name: _each(value, placed) for name, value in identity["options"].items()},
            root=root,
            files={name: _copy(copies / name) for name in identity["files"]},
        )
        for name, digest in source.hashes().items():
            if digest != identity["files"][name]:
                raise InvalidInput(
                    f"{copies / name}: changed since the campaign began; put back what was"
                )
        return source

    def _below(self, value: Any) -> Any:
        """Return a path below the root with ``./`` in place of it; anything else as it is."""
        is_below = isinstance(value, str) and self.root and value.startswith(self.root + os.sep)
        if is_below:
            return "./" + value[len(self.root) + 1 :]
        return value

    def _moved(self, words: Any, folder: Path) -> Any:
        below = self._below(words)
        if below is not words:
            return str(folder / below[2:])
        return words


@lru_cache(maxsize=8)
def _unpacked(digest: str, files: tuple[tuple[str, bytes], ...]) -> Path:
    """Write the files into a folder, which other processes of this machine use, too."""
    user = os.getuid() if hasattr(os, "getuid") else ""
    folder = Path(tempfile.gettempdir(), f"uvms_ocp_{user}_{digest[:24]}")
    if folder.is_dir() and _is_intact(folder, dict(files)):
        return folder
    fresh = Path(tempfile.mkdtemp(prefix="uvms_ocp_"))
    for name, content in files:
        (fresh / name).parent.mkdir(parents=True, exist_ok=True)
        (fresh / name).write_bytes(content)
    try:
        os.rename(fresh, folder)
    except OSError:  # another process was first
        if not _is_intact(folder, dict(files)):
            return fresh
        durable_files.discard(fresh)
    return folder


def _is_intact(root: Path, files: Mapping[str, bytes]) -> bool:
    try:
        for name, content in files.items():
            is_of_user = not name.startswith(_PACKED)
            if is_of_user and (root / name).read_bytes() != content:
                return False
    except OSError:
        return False
    return True


def _contents(paths: set[Path]) -> dict[str, bytes]:
    """Read files by name: below the root, or, for the toolkit's own robots, below `_PACKED`."""
    root = _common(paths)
    packed = robots_folder().resolve()
    contents = {}
    for path in sorted(paths):
        if path.is_relative_to(packed):
            name = _PACKED + path.relative_to(packed).as_posix()
        else:
            name = path.relative_to(root).as_posix()
        contents[name] = path.read_bytes()
    return contents


def _common(paths: set[Path]) -> str:
    """Return the folder that holds all files but those of the toolkit's own robots."""
    packed = robots_folder().resolve()
    folders = [path.parent for path in paths if not path.is_relative_to(packed)]
    if folders:
        return os.path.commonpath(folders)
    return ""


def _copy(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InvalidInput(
            f"{path}: cannot be read ({error.strerror}); put back what was"
        ) from None


def _each(value: Any, change: Callable[[Any], Any]) -> Any:
    """Return the value with a change applied to everything in it."""
    if isinstance(value, Mapping):
        return {name: _each(item, change) for name, item in value.items()}
    if isinstance(value, list):
        return [_each(item, change) for item in value]
    return change(value)


def _absolute(value: Any) -> Any:
    if isinstance(value, str | Path) and Path(value).exists():
        return str(Path(value).resolve())
    return value


def _placed(words: str, folder: Path) -> str:
    """Return the words with the whole path of their file."""
    code = own_code(words)
    if code is None or code.file is None:
        return words
    path = str((folder / code.file).resolve())
    if words.endswith(".py"):
        return path
    attribute = words.rpartition(":")[2]
    return f"{path}:{attribute}"
