"""Write the files of a controller in C."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from uvms_ocp.codegen.kernel_layout import Layout, structure_of
from uvms_ocp.codegen.kernels import CLibrary, c_library
from uvms_ocp.control import DynamicController, KinematicController
from uvms_ocp.control.velocity.tick import velocity_controller
from uvms_ocp.errors import InvalidInput, plain_line
from uvms_ocp.export.running import interface_types
from uvms_ocp.export.tick import ControllerInputs, ControllerOutputs, ForceController, control_force, control_velocity
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet, core_source

# The files of a controller in C.

_INITIAL = "CONTROLLER_INITIAL"
TEMPLATES = ("replay.c", "CMakeLists.txt")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ControllerNames:
    """Names of the controller's phases, statuses and quantities."""

    phases: tuple[str, ...]
    """In the order of `ControllerOutputs.phase`."""
    statuses: tuple[str, ...]
    """In that of `ControllerOutputs.status`."""
    quantities: tuple[str, ...]
    """In that of `ControllerOutputs.quantities`."""
    channels: tuple[str, ...]
    """In that of `ControllerInputs.trust`."""

    def texts(self) -> dict[str, list[str]]:
        """Return them by the names of their arrays in C, as far as they can stand in a text there; never empty."""
        found = {name: [_plain(text) for text in getattr(self, name)] for name in self.__dataclass_fields__}
        return {f"CONTROLLER_{name.upper()}": texts or [""] for name, texts in found.items()}


def header(library: CLibrary, names: ControllerNames, memory: str) -> str:
    """Controller.h; memory: the name of the type of all that is remembered."""
    return "\n".join(
        [
            "#ifndef CONTROLLER_H",
            "#define CONTROLLER_H",
            "/* All that the controller remembers is a Controller; its parts are nobody else's business. */",
            library.types,
            f"typedef {memory} Controller;",
            _documented(ControllerInputs),
            _documented(ControllerOutputs),
            "/* Begin the mission. */",
            "void controller_reset(Controller *controller);",
            "/* One tick. */",
            "void controller_step(Controller *controller, const ControllerInputs *in, ControllerOutputs *out);",
            *(f"extern const char *const {name}[{len(texts)}];" for name, texts in names.texts().items()),
            "/* Bytes of a Controller, of its inputs and of its outputs. */",
            "extern const unsigned long CONTROLLER_SIZES[3];",
            "#endif",
            "",
        ]
    )


def source(library: CLibrary, names: ControllerNames, kernel: str) -> str:
    """Controller.c, whose tick is the `kernel` of that name."""
    return "\n".join(
        [
            '#include "controller.h"',
            library.declarations,
            library.kernels,
            f"extern const Controller {_INITIAL};",
            f"void controller_reset(Controller *controller) {{ *controller = {_INITIAL}; }}",
            "void controller_step(Controller *controller, const ControllerInputs *in, ControllerOutputs *out) {",
            "  ControllerInputs inputs = *in;",
            f"  k_{kernel}(controller, &inputs, out);",
            "}",
            *(f"const char *const {name}[] = {_texts(texts)};" for name, texts in names.texts().items()),
            "const unsigned long CONTROLLER_SIZES[3] = {",
            "    sizeof(Controller), sizeof(ControllerInputs), sizeof(ControllerOutputs)};",
            "",
        ]
    )


def initial(library: CLibrary) -> str:
    """initial.c: a file of its own, as compilers that see megabytes of it look for what follows from them for minutes."""
    value = f"const Controller {_INITIAL} = {library.initial};"
    return "\n".join(["#include <math.h>", '#include "controller.h"', library.declarations, value, ""])


def template(name: str) -> str:
    """The text of a file that is the same for all controllers, or of README.md with what is to be filled in."""
    return files("uvms_ocp.export").joinpath("templates", name).read_text(encoding="utf-8")


def table(names: Sequence[str]) -> str:
    """Rows of Markdown: place and name."""
    return "\n".join(f"| {place} | {_plain(name)} |" for place, name in enumerate(names))


def _texts(texts: Sequence[str]) -> str:
    return "{" + ", ".join(f'"{text}"' for text in texts) + "}"


def _plain(name: str) -> str:
    """Nothing in it ends a string, a comment or a cell of a table, or begins something else."""
    return "".join(c for c in plain_line(name) if c.isascii() and c not in '"\\?*/|')


def _documented(layout: type[Layout]) -> str:
    lines = [f"   {name}: {text}" for name, text in field_docs(layout).items()]
    return "\n".join([f"/* {layout.__name__}: {inspect.cleandoc(layout.__doc__ or '')}", *lines, "*/"])


def field_docs(layout: type[Layout]) -> Mapping[str, str]:
    """Return the docstring of each field of a layout, or of the next one that has one."""
    body = _class_body(layout)
    texts, waiting = dict[str, str](), list[str]()
    for node in body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            waiting.append(node.target.id)
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and waiting:
            texts |= dict.fromkeys(waiting, inspect.cleandoc(str(node.value.value)))
            waiting.clear()
    return texts


def _class_body(layout: type[Layout]) -> Sequence[ast.stmt]:
    (found,) = ast.parse(textwrap.dedent(inspect.getsource(layout))).body
    return found.body if isinstance(found, ast.ClassDef) else []


# A controller of Python as one in C: its memory at the beginning of a mission, and the texts.


def interface_sizes(controller: KinematicController, n_thrusters: int) -> dict[str, int]:
    """Return the sizes of `ControllerInputs` and `ControllerOutputs`."""
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


def controller_library(memory: Any, sizes: dict[str, int]) -> CLibrary:
    """Texts of a `controller_memory`, with these `sizes_of`."""
    return c_library((kernel_of(memory),), memory, interface_types(sizes))
