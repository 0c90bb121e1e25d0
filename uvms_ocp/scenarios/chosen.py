"""A scenario by what a command line says: a name, or code of one's own, with options in the same words."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from inspect import Parameter, signature
from pathlib import Path
from typing import Any

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.model.files.library import robot_folder
from uvms_ocp.model.loading import load_robot
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import IDEAL_SENSORS, sensors_of
from uvms_ocp.scenario import Scenario
from uvms_ocp.scenarios.own_code import own_code
from uvms_ocp.scenarios.run_options import field_of
from uvms_ocp.sim.faults.notation import parse_faults
from uvms_ocp.sim.seafloor import FlatSeafloor

_OF_A_VALUE = ("plant", "solver", "current", "seabed", "seed", "noise", "duration", "dt", "faults")


@checked
def chosen_scenario(words: str, options: Mapping[str, Any], makers: Mapping[str, Callable[..., Scenario]]) -> Scenario:
    """The scenario of these words: one of the `makers` by name, ``file.py``, ``file.py:name`` or ``package.module:name``.

    Code of one's own gives a `Scenario`, or a function that makes one and takes those options that it wants to. robot and
    hydrodynamics may be names or files. Raises `NameNotFound` for an unknown name, `InvalidInput` for an option that the
    scenario does not take.
    """
    given = with_robot(options)
    code = own_code(words)
    if code is None:
        if words not in makers:
            raise NameNotFound("scenario", words, makers)
        return makers[words](**given)
    found = code.load()
    if isinstance(found, Scenario):
        return _with_options(words, found, given)
    if not callable(found):
        raise InvalidInput(f"{words} is a {type(found).__name__}; give a Scenario, or a function that makes one")
    made = code.called(found, **_taken(words, found, given))
    if not isinstance(made, Scenario):
        raise InvalidInput(f"{words} made a {type(made).__name__}; make a Scenario")
    return made


def with_robot(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options with the robot of a name, a folder or a URDF, and its hydrodynamics file, as a `Robot`.

    Raises `InvalidInput` for a hydrodynamics file without a robot.
    """
    given = dict(options)
    water = given.pop("hydrodynamics", None)
    if isinstance(given.get("robot"), str):
        given["robot"] = robot_of(given["robot"], water)
    elif water is not None:
        text = "give both, --robot the folder or URDF that they are of, or a robot alone"
        raise InvalidInput(f"hydrodynamics {water} without a robot; {text}")
    return given


def robot_of(words: str, hydrodynamics: Path | str | None = None) -> Robot:
    """The robot of a URDF, a folder with robot.urdf and hydrodynamics.yaml, or a name; with other hydrodynamics if given."""
    path = Path(words)
    is_name = words == path.name and not path.suffix and not path.exists()
    if is_name:
        robot_folder(words)  # refuses an unknown one
        return load_robot(words, hydrodynamics=hydrodynamics)
    if path.is_dir():
        water = hydrodynamics or (path / "hydrodynamics.yaml" if (path / "hydrodynamics.yaml").exists() else None)
        return load_robot(urdf=path / "robot.urdf", hydrodynamics=water)
    return load_robot(urdf=path, hydrodynamics=hydrodynamics)


def _taken(words: str, maker: Callable[..., Any], given: Mapping[str, Any]) -> Mapping[str, Any]:
    parameters = signature(maker).parameters.values()
    if any(parameter.kind is Parameter.VAR_KEYWORD for parameter in parameters):
        return given
    known = [parameter.name for parameter in parameters]
    for name in given:
        if name not in known:
            takes = f"; it takes {', '.join(known)}" if known else ""
            raise InvalidInput(f"{words} takes no option {name}{takes}: leave it out, or give the function a **options")
    return given


def _with_options(words: str, scenario: Scenario, given: Mapping[str, Any]) -> Scenario:
    """A scenario that is a value, with what can be changed of it."""
    for name in given:
        if name not in _OF_A_VALUE:
            text = f"{words} is a Scenario, whose {name} is fixed"
            raise InvalidInput(f"{text}; leave the option out, or make it a function that takes {name}")
    own = {name: value for name, value in given.items() if name in ("plant", "solver", "seed", "duration", "dt")}
    environment = scenario.environment
    if "current" in given:
        environment = replace(environment, current=field_of(given["current"]))
    if "seabed" in given:
        environment = replace(environment, seafloor=FlatSeafloor(z=given["seabed"]))
    if "noise" in given:
        own["sensors"] = sensors_of(scenario.robot.description) if given["noise"] else IDEAL_SENSORS
    if "faults" in given:
        own["faults"] = parse_faults(given["faults"])
    return replace(scenario, environment=environment, **own)
