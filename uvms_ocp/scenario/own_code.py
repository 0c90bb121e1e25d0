"""Load a scenario by name or from a user's code, ``file.py``, ``file.py:name`` or
``package.module:name``. To load code is to run it.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import sys
import traceback
from collections.abc import Callable, Mapping
from inspect import Parameter, signature
from pathlib import Path
from types import ModuleType
from typing import Any

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput, NameNotFound, UvmsError, plain_line
from uvms_ocp.robot.loading import robot_called
from uvms_ocp.scenario.options import CHANGEABLE, apply_options
from uvms_ocp.scenario.scenario import Scenario

_PREFIX = "uvms_own_"
"""Prefix of the names of modules that are files of users."""
_HELPERS = dict[str, Path]()
"""Names of modules that files of users have imported, with the folder of the file."""
_FOLDERS = set[Path]()
"""Folders that code of users has been loaded from."""


def load_scenario(
    words: str, options: Mapping[str, Any], makers: Mapping[str, Callable[..., Scenario]]
) -> Scenario:
    """Return the scenario that a command line names: one of the `makers` by name, ``file.py``,
    ``file.py:name`` or ``package.module:name``.

    A user's code gives a `Scenario`, or a function that makes one and takes those options that it
    wants to. robot and hydrodynamics may be names or files. Raises `NameNotFound` for an unknown
    name, `InvalidInput` for an option that the scenario does not take.
    """
    code = own_code(words)
    if code is None and words not in makers:
        raise NameNotFound("scenario", words, makers)
    resolved = with_robot(options)
    if code is None:
        return makers[words](**resolved)
    value = code.load()
    if isinstance(value, Scenario):
        return _changed_scenario(words, value, resolved)
    if not callable(value):
        raise InvalidInput(
            f"{words} is a {type(value).__name__}; give a Scenario, or a function that makes one"
        )
    _require_parameters(words, value, resolved)
    scenario = code.called(value, **resolved)
    if not isinstance(scenario, Scenario):
        raise InvalidInput(f"{words} made a {type(scenario).__name__}; make a Scenario")
    return scenario


def _changed_scenario(words: str, scenario: Scenario, options: Mapping[str, Any]) -> Scenario:
    """Return a user's scenario with these options; raises `InvalidInput` for one that is fixed."""
    for name in options:
        if name not in CHANGEABLE:
            text = f"{words} is a Scenario, whose {name} is fixed"
            raise InvalidInput(
                f"{text}; leave the option out, or make it a function that takes {name}"
            )
    return apply_options(scenario, options)


def _require_parameters(words: str, maker: Callable[..., Any], options: Mapping[str, Any]) -> None:
    """Raise `InvalidInput` for an option that a user's function does not take."""
    parameters = signature(maker).parameters
    if any(parameter.kind is Parameter.VAR_KEYWORD for parameter in parameters.values()):
        return
    for name in options:
        if name not in parameters:
            taken_options = ""
            if parameters:
                taken_options = f"; it takes {', '.join(parameters)}"
            raise InvalidInput(
                f"{words} takes no option {name}{taken_options}: leave it out, or give the function"
                " a **options"
            )


def with_robot(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options with the robot of a name, a folder or a URDF, its hydrodynamics file and
    how it is read, as a `Robot`.

    Raises `InvalidInput` for a hydrodynamics file, or options of loading, without a robot.
    """
    resolved = dict(options)
    water = resolved.pop("hydrodynamics", None)
    loading = resolved.pop("loading", None)
    if isinstance(resolved.get("robot"), str):
        resolved["robot"] = robot_called(resolved["robot"], water, loading)
    elif water is not None:
        text = "give both, --robot the folder or URDF that they are of, or a robot alone"
        raise InvalidInput(f"hydrodynamics {water} without a robot; {text}")
    elif loading:
        text = (
            "give --robot the folder or URDF that they are of, or write them into its"
            " hydrodynamics.yaml"
        )
        raise InvalidInput(f"{', '.join(loading)} without a robot; {text}")
    return resolved


@checked_dataclass()
class UserCode:
    """Place of code of the user: in a file, or in a module."""

    attribute: str
    """Name of the scenario, or other value, that it defines."""
    file: Path | None = None
    """A Python file."""
    module: str = ""
    """An installed module, or one in the working directory."""

    def load(self) -> Any:
        """Run the code, and return what is wanted of it.

        Raises `InvalidInput` for code that is not there or fails, in one line with its place, and
        `NameNotFound` for a name that it does not define.
        """
        module = self._module()
        if hasattr(module, self.attribute):
            return getattr(module, self.attribute)
        names = []
        for name, value in vars(module).items():
            if not name.startswith("_") and not isinstance(value, ModuleType):
                names.append(name)
        raise NameNotFound(f"name in {self.file or self.module}", self.attribute, names)

    def called(self, function: Callable[..., Any], **options: Any) -> Any:
        """Return the result of a function of it. Raises `InvalidInput` where it fails, in one line
        with its place.
        """
        try:
            return function(**options)
        except UvmsError:
            raise
        except (Exception, SystemExit) as error:
            place = self.module
            if self.file is not None:
                place = str(self.file.resolve())
            raise _failed(place, error) from error

    def _module(self) -> ModuleType:
        if self.file is None:
            return _imported(self.module)
        if not self.file.is_file():
            raise InvalidInput(
                f"{self.file}: there is no such file; give a Python file, or a name of `uvms-ocp"
                " list`"
            )
        return _of_file(self.file.resolve())


def own_code(words: str, attribute: str = "scenario") -> UserCode | None:
    """Find the code that these words point to; `None` for a plain name. attribute: what is wanted
    unless the words say it.
    """
    place, colon, name = words.rpartition(":")
    if not colon or "/" in name or "\\" in name:
        place = words
        name = ""
    attribute_name = name or attribute
    if place.endswith(".py"):
        return UserCode(file=Path(place), attribute=attribute_name)
    if colon and name:
        return UserCode(module=place, attribute=attribute_name)
    return None


def siblings(folder: Path) -> list[Path]:
    """List the files below `folder` of all modules that have been imported so far."""
    paths = set[Path]()
    for module in list(sys.modules.values()):
        path = _file_of(module)
        if path is not None and path.suffix == ".py" and path.is_relative_to(folder):
            paths.add(path)
    return sorted(paths)


def _file_of(module: ModuleType | None) -> Path | None:
    """Return the file of a module, if it has one."""
    file = getattr(module, "__file__", None)
    if not file:
        return None
    return Path(file).resolve()


def _imported(name: str) -> ModuleType:
    """Import an installed module, or one in the working directory."""
    package, _, _ = name.partition(".")
    # Words such as os:system may stand in a folder that somebody sent.
    if package in sys.stdlib_module_names:
        raise InvalidInput(
            f"{name}: is of Python itself, and makes no scenario; give a module of your own"
        )
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        module = importlib.import_module(name)
    except (Exception, SystemExit) as error:
        missing_name = None
        if isinstance(error, ModuleNotFoundError):
            missing_name = error.name
        if missing_name and (name == missing_name or name.startswith(f"{missing_name}.")):
            text = (
                f"{name}: there is no such module; install it, or give a file such as"
                " mission.py:scenario"
            )
            raise InvalidInput(text) from None
        raise _failed(name, error) from error
    _FOLDERS.add(Path(module.__file__ or "").parent)
    return module


def _of_file(path: Path) -> ModuleType:
    """Return the module of a file, run anew where the file has changed since."""
    content = path.read_bytes()
    name = f"{_PREFIX}{hashlib.sha256(str(path).encode() + content).hexdigest()[:16]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise InvalidInput(f"{path}: cannot be loaded; give a Python file")
    module = importlib.util.module_from_spec(spec)
    _drop_helpers(path.parent)
    _FOLDERS.add(path.parent)
    loaded_modules = set(sys.modules)
    sys.modules[name] = module  # where dataclasses look for it
    sys.path.insert(0, str(path.parent))
    try:
        spec.loader.exec_module(module)
    except BaseException as error:
        del sys.modules[name]
        if isinstance(error, Exception | SystemExit):
            raise _failed(str(path), error) from error
        raise
    finally:
        sys.path.remove(str(path.parent))
        for new_name in set(sys.modules) - loaded_modules:
            if not new_name.startswith(_PREFIX):
                _HELPERS[new_name] = path.parent
    return module


def _drop_helpers(folder: Path) -> None:
    """Forget modules of other folders, which would stand in for those of the same name in this
    one.
    """
    for name, home in list(_HELPERS.items()):
        file = _file_of(sys.modules.get(name))
        if home != folder and file is not None and file.is_relative_to(home):
            del sys.modules[name]
            del _HELPERS[name]


def own_failure(error: BaseException) -> str:
    """Describe an error of a user's code in one line, with the last place in it; empty for one that
    comes from elsewhere.
    """
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if Path(frame.filename).parent in _FOLDERS:
            return f"{frame.filename}:{frame.lineno}: {_error_text(error)}"
    return ""


def _error_text(error: BaseException) -> str:
    """Return an error in one line, with its type."""
    return plain_line(f"{type(error).__name__}: {error}")


def _failed(place: str, error: BaseException) -> UvmsError:
    """Return an error of a user's code as one of ours, with its place."""
    if isinstance(error, SyntaxError):
        return InvalidInput(f"{place}:{error.lineno}: {error.msg}")
    return InvalidInput(own_failure(error) or f"{place}: {_error_text(error)}")


def forget_user_code() -> None:
    """Run files of users anew when they are loaded the next time."""
    for name in list(sys.modules):
        if name.startswith(_PREFIX):
            del sys.modules[name]
