"""Task-priority planning and optimal control of underwater vehicle-manipulator systems.

Public names, each loaded when it is first asked for; notation and frames: `uvms_ocp.model.spatial`.
"""

from __future__ import annotations

import ast
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uvms_ocp.version import __version__ as __version__

if TYPE_CHECKING:
    from uvms_ocp import scenarios as scenarios
    from uvms_ocp.control.velocity.kinematic import KinematicController as KinematicController
    from uvms_ocp.exceptions import UvmsError as UvmsError
    from uvms_ocp.export.controller import export_controller as export_controller
    from uvms_ocp.mission.conditions import DONE as DONE
    from uvms_ocp.mission.conditions import Above as Above
    from uvms_ocp.mission.conditions import Below as Below
    from uvms_ocp.mission.conditions import Transition as Transition
    from uvms_ocp.mission.mission import Mission as Mission
    from uvms_ocp.mission.phase import Phase as Phase
    from uvms_ocp.mission_plan.planning import plan_mission as plan_mission
    from uvms_ocp.model.assembly.mounting import mount as mount
    from uvms_ocp.model.assembly.mounting import without_arm as without_arm
    from uvms_ocp.model.dynamics import robot_dynamics as robot_dynamics
    from uvms_ocp.model.files.library import list_robots as list_robots
    from uvms_ocp.model.kinematics import Kinematics as Kinematics
    from uvms_ocp.model.loading import load_robot as load_robot
    from uvms_ocp.model.robot import Robot as Robot
    from uvms_ocp.model.symbolic.tree import SymbolicModel as SymbolicModel
    from uvms_ocp.model.water.hydrodynamics import Water as Water
    from uvms_ocp.record import Record as Record
    from uvms_ocp.report.summary import summarize as summarize
    from uvms_ocp.scenario import Scenario as Scenario
    from uvms_ocp.scenario import pose_at as pose_at
    from uvms_ocp.sim.currents import UniformCurrent as UniformCurrent
    from uvms_ocp.sim.environment import Environment as Environment
    from uvms_ocp.sim.seafloor import FlatSeafloor as FlatSeafloor
    from uvms_ocp.solvers.hierarchy.active_set.solver import (
        LexicographicActiveSet as LexicographicActiveSet,
    )
    from uvms_ocp.solvers.hierarchy.cascade.solver import LexicographicQp as LexicographicQp
    from uvms_ocp.solvers.hierarchy.icat import Icat as Icat
    from uvms_ocp.solvers.hierarchy.level import Level as Level
    from uvms_ocp.solvers.hierarchy.solution import Solution as Solution
    from uvms_ocp.solvers.hierarchy.solution import Status as Status
    from uvms_ocp.tasks.hierarchy import Hierarchy as Hierarchy


def _places() -> dict[str, tuple[str, str]]:
    """By name, the module and what it is called there: what type checkers are told above, written once."""
    tree = ast.parse(Path(__file__).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    imports = (node for node in block.body if isinstance(node, ast.ImportFrom))
    return {str(alias.asname): (str(node.module), alias.name) for node in imports for alias in node.names}


_PLACES = _places()


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        from difflib import get_close_matches

        near = get_close_matches(name, _PLACES, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{hint}")
    module, own = _PLACES[name]
    value = import_module(f"{module}.{own}") if module == __name__ else getattr(import_module(module), own)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*_PLACES, "__version__"]
