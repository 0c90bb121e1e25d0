"""Expand xacro, by the package ``xacrodoc`` (extra ``xacro``). Macros of a file are computed by
xacro, which evaluates expressions that stand there.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import redirect_stderr
from io import StringIO
from pathlib import Path
from xml.etree import ElementTree

from uvms_ocp.errors import RobotDataError
from uvms_ocp.record.untrusted import note_file_read
from uvms_ocp.robot.urdf_elements import Element
from uvms_ocp.robot.urdf_meshes import find_package

_NAMESPACE = re.compile(r"\{[^}]*xacro[^}]*\}")
_MOST_PACKAGES = 50  # that one file names
_LONGEST_REASON = 200  # characters of what xacro says
_SET = "a file that states others in <xacro:arg> and includes this one sets them"
_INSTALL = 'pip install "uvms-ocp[xacro]"'


def uses_xacro(path: Path, root: Element) -> bool:
    """Check for a file that xacro has to expand: by its name, or an element of xacro in it."""
    if path.suffix == ".xacro":
        return True
    return any(_NAMESPACE.match(str(element.tag)) for element in root.iter())


def expanded(path: Path, folders: Sequence[Path]) -> tuple[Element, tuple[str, ...]]:
    """Return the root of what xacro makes of a file, and a note. folders: where packages are.

    Raises ``RobotDataError`` where xacro is not installed or refuses the file.
    """
    try:
        import xacro
        import xacrodoc
    except ImportError:
        raise RobotDataError(path, f"a file of xacro, which needs an extra: {_INSTALL}") from None
    xacrodoc.packages.reset()
    known_packages = dict[str, Path]()
    while True:
        xacrodoc.packages.update_package_cache(known_packages)
        try:
            with redirect_stderr(StringIO()):  # to which xacro writes doubts of its macros
                text = xacro.process_file(str(path.resolve())).toxml()
            break
        except Exception as error:  # of expressions in the file: of any kind
            cause = _cause(error)
            if not isinstance(cause, xacrodoc.packages.PackageNotFoundError):
                reason = " ".join(f"{type(error).__name__}: {error}".split())[:_LONGEST_REASON]
                raise RobotDataError(path, f"xacro refuses it ({reason})") from None
            package = str(cause.args[0])
        folder = find_package(package, folders)
        if folder is None or package in known_packages or len(known_packages) >= _MOST_PACKAGES:
            raise RobotDataError(
                path,
                f"xacro: package {package!r} is not found; --packages DIR names a folder of"
                " packages",
            )
        known_packages[package] = folder
    for file in xacro.all_includes:
        note_file_read(Path(file))
    root = ElementTree.fromstring(text)
    stated = xacro.substitution_args_context.get("arg", {})
    arguments = ", ".join(f"{name}:={value}" for name, value in sorted(stated.items()))
    if arguments:
        return root, (f"expanded by xacro with {arguments}; {_SET}",)
    return root, ("expanded by xacro",)


def _cause(error: BaseException) -> BaseException:
    """Return the error that xacro wraps in errors of its own."""
    wrapped = getattr(error, "exc", None)
    while isinstance(wrapped, BaseException):
        error = wrapped
        wrapped = getattr(error, "exc", None)
    return error
