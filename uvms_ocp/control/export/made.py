"""A controller of Python as one in C: its memory at the beginning of a mission, and the texts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from uvms_ocp.control.export.exported import interface_types
from uvms_ocp.control.export.step import ForceController, control_force, control_velocity
from uvms_ocp.control.force.dynamic import DynamicController
from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.control.velocity.tick.solving import velocity_controller
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.functions.kernels.c_library import CLibrary, c_library
from uvms_ocp.functions.kernels.layout import structure_of
from uvms_ocp.solvers.hierarchy.active_set.core_source import core_source
from uvms_ocp.solvers.hierarchy.active_set.solver import LexicographicActiveSet


def sizes_of(controller: KinematicController, n_thrusters: int) -> dict[str, int]:
    """[-] of what goes in and out."""
    robot = controller.robot
    return {
        "n_q": robot.n_q,
        "n_v": robot.n_v,
        "n_joints": robot.n_joints,
        "n_thrusters": n_thrusters,
        "n_quantities": len(controller.problem.quantity_names),
    }


def solver_file(controller: KinematicController) -> str:
    """The text of solver.c: the solver of hierarchies, as its CasADi function calls it."""
    problem = controller.problem
    return core_source(problem.function.size2_out(0), problem.sizes)


def controller_memory(controller: KinematicController | DynamicController) -> Any:
    """A `VelocityController` at the beginning of the mission of a fresh one, or a `ForceController` where it has that layer.

    Raises `InvalidInput` without a C compiler.
    """
    kinematic = controller.kinematic
    below = velocity_controller(kinematic.memory, kinematic.problem, LexicographicActiveSet())
    if below is None:
        raise InvalidInput("the controller cannot be written without a C compiler; give one (CC, cc, gcc, clang)")
    if not isinstance(controller, DynamicController):
        return below
    memory: Any = structure_of(ForceController, velocity=type(below), force=type(controller.memory))()
    memory.velocity, memory.force = below, controller.memory
    return memory


def kernel_of(memory: Any) -> Callable[..., None]:
    """The tick of a `controller_memory`."""
    return control_force if hasattr(memory, "force") else control_velocity


def c_controller(memory: Any, sizes: dict[str, int]) -> CLibrary:
    """Texts of a `controller_memory`, which is given and tells what is of these `sizes_of`."""
    return c_library((kernel_of(memory),), memory, interface_types(sizes))
