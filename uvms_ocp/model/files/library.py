"""Where robots are found: ``robots/`` packed into the package, or the one of an editable checkout."""

from __future__ import annotations

import importlib.metadata
from pathlib import Path

from uvms_ocp.exceptions import InvalidInput, NameNotFound

_PACKAGE = Path(__file__).resolve().parents[2]


def robots_folder() -> Path:
    """Return the folder that holds one folder per robot."""
    packed = _PACKAGE / "robots"
    return packed if packed.is_dir() else _PACKAGE.parent / "robots"


def list_robots() -> tuple[str, ...]:
    """Return the names that ``load_robot`` knows, sorted."""
    return tuple(sorted(path.parent.name for path in robots_folder().glob("*/robot.urdf")))


def robot_folder(name: str) -> Path:
    """Return the folder of a robot. Raises ``NameNotFound`` with the alternatives."""
    if name not in list_robots():
        raise NameNotFound("robot", name, list_robots())
    return robots_folder() / name


def list_variants(name: str) -> tuple[str, ...]:
    """Return the names of the other published data sets of a robot, sorted; ``load_robot(name, variant=...)``."""
    return tuple(sorted(path.stem for path in (robot_folder(name) / "variants").glob("*.yaml")))


def variant_file(name: str, variant: str) -> Path:
    """Return the file of a variant. Raises ``NameNotFound`` with the alternatives."""
    if variant not in list_variants(name):
        raise NameNotFound(f"variant of {name}", variant, list_variants(name))
    return robot_folder(name) / "variants" / f"{variant}.yaml"


def example_robot_data() -> Path:
    """Return the folder of the package example-robot-data, which holds ``robots/<maker>_description``.

    Raises ``InvalidInput`` telling how to install it.
    """
    for path in _files_of("example-robot-data"):
        if path.name == "package.xml" and path.parent.name == "example-robot-data":
            return path.parent
    raise InvalidInput('example-robot-data is not installed; run: pip install "uvms-ocp[robots]"')


def _files_of(distribution: str) -> list[Path]:
    try:
        files = importlib.metadata.files(distribution)
    except importlib.metadata.PackageNotFoundError:
        return []
    return [Path(str(file.locate())).resolve() for file in files or ()]
