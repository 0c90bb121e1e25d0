"""What a user has written in Python: ``file.py``, ``file.py:name`` or ``package.module:name``. To load it is to run it."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput, NameNotFound, UvmsError, plain_line

_PREFIX = "uvms_own_"  # of modules
_HELPERS: dict[str, Path] = {}  # modules that files of one's own have imported, with the folder of the file


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class OwnCode:
    """Where it is. Raises `InvalidInput` for neither a file nor a module, or both."""

    attribute: str
    """What is wanted of it."""
    file: Path | None = None
    """A Python file."""
    module: str = ""
    """An installed module, or one in the working directory."""

    def __post_init__(self) -> None:
        if (self.file is None) == (not self.module):
            raise InvalidInput(f"file = {self.file}, module = {self.module!r}; give one of them")

    def load(self) -> Any:
        """Run the code, and return what is wanted of it.

        Raises `InvalidInput` for code that is not there or fails, in one line with its place, and `NameNotFound` for a name
        that it does not define.
        """
        found = self._module()
        if not hasattr(found, self.attribute):
            own = [name for name, value in vars(found).items() if not name.startswith("_") and not _is_module(value)]
            raise NameNotFound(f"name in {self.file or self.module}", self.attribute, own)
        return getattr(found, self.attribute)

    def called(self, function: Callable[..., Any], **options: Any) -> Any:
        """What a function of it makes. Raises `InvalidInput` where it fails, in one line with its place."""
        try:
            return function(**options)
        except UvmsError:
            raise
        except Exception as error:
            raise _failed(str(self.file.resolve() if self.file else self.module), error) from error

    def _module(self) -> ModuleType:
        if self.file is None:
            return _imported(self.module)
        if not self.file.is_file():
            raise InvalidInput(f"{self.file}: there is no such file; give a Python file, or a name of `uvms-ocp list`")
        return _of_file(self.file.resolve())


@checked
def own_code(words: str, attribute: str = "scenario") -> OwnCode | None:
    """Where these words point to; `None` for those that are a plain name. attribute: what is wanted unless they say it."""
    place, colon, name = words.rpartition(":")
    if not colon or "/" in name or "\\" in name:
        place, name = words, ""
    wanted = name or attribute
    if place.endswith(".py"):
        return OwnCode(file=Path(place), attribute=wanted)
    return OwnCode(module=place, attribute=wanted) if colon and name else None


def siblings(folder: Path) -> list[Path]:
    """Files below `folder` of all modules that have been imported so far."""
    files = [getattr(module, "__file__", None) for module in list(sys.modules.values())]
    paths = [Path(file).resolve() for file in files if file]
    return sorted({path for path in paths if path.suffix == ".py" and path.is_relative_to(folder)})


def _imported(name: str) -> ModuleType:
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name and (name == error.name or name.startswith(f"{error.name}.")):
            text = f"{name}: there is no such module; install it, or give a file such as mission.py:scenario"
            raise InvalidInput(text) from None
        raise _failed(name, error) from error
    except Exception as error:
        raise _failed(name, error) from error


def _of_file(path: Path) -> ModuleType:
    """The module of a file, run anew where the file has changed since."""
    content = path.read_bytes()
    name = f"{_PREFIX}{hashlib.sha256(str(path).encode() + content).hexdigest()[:16]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise InvalidInput(f"{path}: cannot be loaded; give a Python file")
    module = importlib.util.module_from_spec(spec)
    _drop_helpers(path.parent)
    before = set(sys.modules)
    sys.modules[name] = module  # where dataclasses look for it
    sys.path.insert(0, str(path.parent))
    try:
        spec.loader.exec_module(module)
    except BaseException as error:
        del sys.modules[name]
        if isinstance(error, Exception):
            raise _failed(str(path), error) from error
        raise
    finally:
        sys.path.remove(str(path.parent))
        _HELPERS.update({new: path.parent for new in set(sys.modules) - before if not new.startswith(_PREFIX)})
    return module


def _drop_helpers(folder: Path) -> None:
    """Modules of other folders would stand in for those of the same name in this one."""
    for name, home in list(_HELPERS.items()):
        file = getattr(sys.modules.get(name), "__file__", None)
        if home != folder and file and Path(file).resolve().is_relative_to(home):
            del sys.modules[name], _HELPERS[name]


def _failed(what: str, error: Exception) -> UvmsError:
    if isinstance(error, SyntaxError):
        return InvalidInput(f"{what}:{error.lineno}: {error.msg}")
    own = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename == what]
    place = f"{what}:{own[-1].lineno}" if own else what
    return InvalidInput(f"{place}: {type(error).__name__}: {plain_line(str(error))}")


def _is_module(value: Any) -> bool:
    return isinstance(value, ModuleType)


def forget() -> None:
    """Run files of one's own anew when they are loaded the next time."""
    for name in [name for name in sys.modules if name.startswith(_PREFIX)]:
        del sys.modules[name]
