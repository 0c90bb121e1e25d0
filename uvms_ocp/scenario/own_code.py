"""Load a scenario by name or from a user's code, ``file.py``, ``file.py:name`` or
``package.module:name``, which is run.
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

# What a user has written in Python: ``file.py``, ``file.py:name`` or ``package.module:name``. To
# load it is to run it.

_PREFIX = "uvms_own_"  # of modules
_HELPERS: dict[
    str, Path
] = {}  # modules that files of one's own have imported, with the folder of the file
_FOLDERS: set[Path] = set()  # where code of one's own has been loaded from


@checked_dataclass()
class UserCode:
    """Place of code of the user: in a file, or in a module."""

    attribute: str
    """The name wanted of it."""
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
        if not hasattr(module, self.attribute):
            names = [
                name
                for name, value in vars(module).items()
                if not name.startswith("_") and not isinstance(value, ModuleType)
            ]
            raise NameNotFound(f"name in {self.file or self.module}", self.attribute, names)
        return getattr(module, self.attribute)

    def called(self, function: Callable[..., Any], **options: Any) -> Any:
        """Return the result of a function of it. Raises `InvalidInput` where it fails, in one line
        with its place.
        """
        try:
            return function(**options)
        except UvmsError:
            raise
        except (Exception, SystemExit) as error:
            raise _failed(str(self.file.resolve() if self.file else self.module), error) from error

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
    """Files below `folder` of all modules that have been imported so far."""
    files = [getattr(module, "__file__", None) for module in list(sys.modules.values())]
    paths = [Path(file).resolve() for file in files if file]
    return sorted({path for path in paths if path.suffix == ".py" and path.is_relative_to(folder)})


def _imported(name: str) -> ModuleType:
    if (
        name.partition(".")[0] in sys.stdlib_module_names
    ):  # in a folder that somebody sent, words such as os:system
        raise InvalidInput(
            f"{name}: is of Python itself, and makes no scenario; give a module of your own"
        )
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        module = importlib.import_module(name)
    except (Exception, SystemExit) as error:
        missing = error.name if isinstance(error, ModuleNotFoundError) else None
        if missing and (name == missing or name.startswith(f"{missing}.")):
            text = (
                f"{name}: there is no such module; install it, or give a file such as"
                " mission.py:scenario"
            )
            raise InvalidInput(text) from None
        raise _failed(name, error) from error
    _FOLDERS.add(Path(module.__file__ or "").parent)
    return module


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
        _HELPERS.update(
            {
                new: path.parent
                for new in set(sys.modules) - loaded_modules
                if not new.startswith(_PREFIX)
            }
        )
    return module


def _drop_helpers(folder: Path) -> None:
    """Modules of other folders would stand in for those of the same name in this one."""
    for name, home in list(_HELPERS.items()):
        file = getattr(sys.modules.get(name), "__file__", None)
        if home != folder and file and Path(file).resolve().is_relative_to(home):
            del sys.modules[name], _HELPERS[name]


def own_failure(error: BaseException) -> str:
    """Describe an error of code of one's own in one line, with the place; empty for one that comes
    from elsewhere.
    """
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if Path(frame.filename).parent in _FOLDERS
    ]
    if frames:
        return f"{frames[-1].filename}:{frames[-1].lineno}: {_said(error)}"
    return ""


def _said(error: BaseException) -> str:
    return plain_line(f"{type(error).__name__}: {error}")


def _failed(place: str, error: BaseException) -> UvmsError:
    if isinstance(error, SyntaxError):
        return InvalidInput(f"{place}:{error.lineno}: {error.msg}")
    return InvalidInput(own_failure(error) or f"{place}: {_said(error)}")


def forget_user_code() -> None:
    """Run files of one's own anew when they are loaded the next time."""
    for name in [name for name in sys.modules if name.startswith(_PREFIX)]:
        del sys.modules[name]


# A scenario by what a command line says: a name, or code of one's own, with options in the same
# words.


def load_scenario(
    words: str, options: Mapping[str, Any], makers: Mapping[str, Callable[..., Scenario]]
) -> Scenario:
    """The scenario of these words: one of the `makers` by name, ``file.py``, ``file.py:name`` or
    ``package.module:name``.

    Code of one's own gives a `Scenario`, or a function that makes one and takes those options that
    it wants to. robot and hydrodynamics may be names or files. Raises `NameNotFound` for an unknown
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
        # A scenario that is a value, with what can be changed of it.
        for name in resolved:
            if name not in CHANGEABLE:
                text = f"{words} is a Scenario, whose {name} is fixed"
                raise InvalidInput(
                    f"{text}; leave the option out, or make it a function that takes {name}"
                )
        return apply_options(value, resolved)
    if not callable(value):
        raise InvalidInput(
            f"{words} is a {type(value).__name__}; give a Scenario, or a function that makes one"
        )
    scenario = code.called(value, **_taken(words, value, resolved))
    if not isinstance(scenario, Scenario):
        raise InvalidInput(f"{words} made a {type(scenario).__name__}; make a Scenario")
    return scenario


def with_robot(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options with the robot of a name, a folder or a URDF, its hydrodynamics file and how it
    is read, as a `Robot`.

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


def _taken(words: str, maker: Callable[..., Any], options: Mapping[str, Any]) -> Mapping[str, Any]:
    parameters = signature(maker).parameters.values()
    if any(parameter.kind is Parameter.VAR_KEYWORD for parameter in parameters):
        return options
    names = [parameter.name for parameter in parameters]
    for name in options:
        if name not in names:
            if names:
                takes = f"; it takes {', '.join(names)}"
            else:
                takes = ""
            raise InvalidInput(
                f"{words} takes no option {name}{takes}: leave it out, or give the function a"
                " **options"
            )
    return options
