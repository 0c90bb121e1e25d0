"""Export a scenario's controller, with missions, tasks and gains, as files of C."""

from __future__ import annotations

import ast
import ctypes
import inspect
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.codegen.casadi_code import with_variable
from uvms_ocp.codegen.compile import compile_library, loaded_library
from uvms_ocp.codegen.kernel_layout import Layout, structure_of, view
from uvms_ocp.codegen.kernels import CLibrary, c_library, number
from uvms_ocp.control import DynamicController, KinematicController, build_levels
from uvms_ocp.control.force.tick_functions import column_sizes
from uvms_ocp.control.velocity import position_guards, tick
from uvms_ocp.control.velocity.levels import numbers_of
from uvms_ocp.errors import InvalidInput, plain_line
from uvms_ocp.estimation.degraded_modes import CHANNELS
from uvms_ocp.export import tick as exported_tick
from uvms_ocp.export.tick import ControllerInputs, ControllerOutputs
from uvms_ocp.record.output import claim_folder
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.gjk import ROUNDS
from uvms_ocp.robot.signals import Command, StateEstimate
from uvms_ocp.scenario.scenario import Scenario, our_controller
from uvms_ocp.solvers.hierarchy import solution
from uvms_ocp.solvers.hierarchy.core import CompiledSolver, external_core
from uvms_ocp.tasks.task import Task
from uvms_ocp.version import __version__

# The files of a controller in C.

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
        """Return them by the names of their arrays in C, as far as they can stand in a text there;
        never empty.
        """
        found = {
            name: [_plain(text) for text in getattr(self, name)]
            for name in self.__dataclass_fields__
        }
        return {f"CONTROLLER_{name.upper()}": texts or [""] for name, texts in found.items()}


def header(library: CLibrary, names: ControllerNames, memory: str) -> str:
    """Controller.h; memory: the name of the type of all that is remembered."""
    return Template(template("controller.h")).substitute(
        types=library.types,
        memory=memory,
        inputs=_documented(ControllerInputs),
        outputs=_documented(ControllerOutputs),
        names="\n".join(
            f"extern const char *const {name}[{len(texts)}];"
            for name, texts in names.texts().items()
        ),
    )


def source(
    library: CLibrary,
    names: ControllerNames,
    kernel: str,
    numbers: list[float],
    places: Mapping[str, int],
) -> str:
    """Controller.c, whose tick is the `kernel` of that name."""
    quoted = '", "'
    texts = (
        f'const char *const {name}[] = {{"{quoted.join(texts)}"}};'
        for name, texts in names.texts().items()
    )
    parts = {
        "declarations": library.declarations,
        "kernels": library.kernels,
        "names": "\n".join(texts),
    }
    parts["values"] = ", ".join(number(value) or "0" for value in numbers)
    parts["parameters"] = "".join(
        f'{{"{_plain(name)}", {_NUMBERS} + {k}}}, ' for name, k in places.items()
    )
    return Template(template("controller.c")).substitute(parts, kernel=kernel)


_NUMBERS = "controller_numbers"


def task_numbers(tasks: Sequence[Task], robot: Robot) -> tuple[list[float], dict[str, int]]:
    """Return the numbers of all tasks [as their fields] in the order of their rows, with the two
    that `with_numbers` appends.

    And, by ``task.field``, the places of those that may be changed in C, as rows alone depend on
    them: safety rules beside the rows are compiled with the others.
    """
    every = [(task, name) for task in tasks for name in numbers_of(task)]
    places = {
        f"{task.name}.{name}": k
        for k, (task, name) in enumerate(every)
        if _of_rows_alone(task, robot, name)
    }
    return [*(getattr(*one) for one in every), 0.0, 1.0], places


def _of_rows_alone(task: Task, robot: Robot, name: str) -> bool:
    """Check that rules beside the rows of a task are the same for another number in the field of
    that name.
    """
    other = copy(task)
    object.__setattr__(other, name, getattr(task, name) + 1.0)
    rules = [
        (one.rest_altitude, (limit := one.position_limit(robot)) and limit.lower)
        for one in (task, other)
    ]
    return rules[0] == rules[1]


def template(name: str) -> str:
    """The text of a file that is the same for all controllers, or of one with what is to be filled
    in.
    """
    return files("uvms_ocp.export").joinpath("templates", name).read_text(encoding="utf-8")


def table(names: Sequence[str]) -> str:
    """Rows of Markdown: place and name."""
    return "\n".join(f"| {place} | {literal(name)} |" for place, name in enumerate(names))


def literal(name: str) -> str:
    """A name in Markdown, in a cell too, none of which is read as more than letters."""
    return f"`{re.sub('[`|]', '.', plain_line(name))}`"


def _plain(name: str) -> str:
    """Nothing in it ends a string, a comment or a cell of a table, or begins something else."""
    return "".join(c for c in plain_line(name) if c.isascii() and c not in '"\\?*/|')


def _documented(layout: type[Layout]) -> str:
    lines = [f"   {name}: {text}" for name, text in field_docs(layout).items()]
    return "\n".join(
        [f"/* {layout.__name__}: {inspect.cleandoc(layout.__doc__ or '')}", *lines, "*/"]
    )


def field_docs(layout: type[Layout]) -> Mapping[str, str]:
    """Return the docstring of each field of a layout, or of the next one that has one."""
    (found,) = ast.parse(textwrap.dedent(inspect.getsource(layout))).body
    body = found.body if isinstance(found, ast.ClassDef) else []
    texts = dict[str, str]()
    waiting = list[str]()
    for node in body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            waiting.append(node.target.id)
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and waiting:
            texts |= dict.fromkeys(waiting, inspect.cleandoc(str(node.value.value)))
            waiting.clear()
    return texts


# A controller of Python as one in C: its memory at the beginning of a mission, and the texts.


def interface_sizes(controller: KinematicController, n_thrusters: int) -> dict[str, int]:
    """Return the sizes of `ControllerInputs` and `ControllerOutputs`."""
    return {
        **column_sizes(controller.robot),
        "n_thrusters": n_thrusters,
        "n_quantities": len(controller.problem.quantity_names),
    }


def controller_memory(controller: KinematicController | DynamicController, core: str) -> Any:
    """A `VelocityController` at the beginning of the mission of a fresh one, or a `ForceController`
    where it has that layer.

    core: source of the solver, as `CompiledSolver.core_source`. Raises `InvalidInput` without a C
    compiler.
    """
    kinematic = controller.kinematic
    below = tick.velocity_controller(kinematic.memory, kinematic.problem, external_core(core))
    if below is None:
        raise InvalidInput(
            "the controller cannot be written without a C compiler; give one (CC, cc, gcc, clang)"
        )
    if not isinstance(controller, DynamicController):
        return below
    memory: Any = structure_of(
        exported_tick.ForceController, velocity=type(below), force=type(controller.memory)
    )()
    memory.velocity = below
    memory.force = controller.memory
    return memory


def kernel_of(memory: Any) -> Callable[..., None]:
    """The tick of a `controller_memory`."""
    return (
        exported_tick.control_force if hasattr(memory, "force") else exported_tick.control_velocity
    )


def controller_library(memory: Any, sizes: dict[str, int]) -> CLibrary:
    """Texts of a `controller_memory`, with these `sizes_of`."""
    return c_library((kernel_of(memory),), memory, interface_types(sizes))


# Export the controller of a scenario as files of C, and fly one of these in a scenario.

FILES = (
    "controller.h",
    "controller.c",
    "initial.c",
    "functions.c",
    "solver.c",
    "recorded.bin",
    "README.md",
    *TEMPLATES,
)
"""Files that `export_controller` writes."""


@checked
def export_controller(scenario: Scenario, folder: Path | str) -> list[Path]:
    """Write the controller of a scenario into `folder` as C99 that needs libm only, with a run to
    compare with.

    The scenario is run for that. Returns the files. Raises `InvalidInput` for what has no form in
    C, by its name, and `OutputError` where the folder cannot be written.
    """
    with claim_folder(Path(folder), FILES) as claim:
        _require_c_form(scenario)
        texts, recorded = _texts_controller(scenario)
        with claim.staged() as staging:
            for name, text in texts.items():
                (staging / name).write_text(text, encoding="utf-8")
            (staging / "recorded.bin").write_bytes(recorded)
        return claim.written()


@checked
def exported_controller(folder: Path | str) -> Callable[[Scenario], CController]:
    """Load the files of `export_controller`, for
    ``Scenario(controller=exported_controller(folder))``; needs a C compiler.

    Where it begins to run it raises `InvalidInput` for a folder without a controller, or with that
    of another mission.
    """

    def exported(scenario: Scenario) -> CController:
        kinematic = scenario.kinematic_controller()
        return CController(
            Path(folder),
            interface_sizes(kinematic, _n_thrusters(scenario)),
            forces=scenario.takes_forces,
        )

    return exported


def _texts_controller(scenario: Scenario) -> tuple[dict[str, str], bytes]:
    """Return the text of each file, and the recorded run."""
    controller = our_controller(scenario)
    kinematic = controller.kinematic
    sizes = interface_sizes(kinematic, _n_thrusters(scenario))
    names = ControllerNames(
        phases=tuple(phase.name for phase in scenario.mission.all_phases),
        statuses=tuple(status.name for status in solution.Status),
        quantities=tuple(kinematic.problem.quantity_names),
        channels=CHANNELS,
    )
    numbers, places = task_numbers(scenario.mission.hierarchy.tasks, scenario.robot)
    solver: Any = scenario.solver
    core = solver.core_source(kinematic.problem.function.size2_out(0), kinematic.problem.sizes)
    memory = controller_memory(controller, core)
    run = _recorded(scenario, sizes)
    library = controller_library(memory, sizes)
    readme = template("README.md").format(
        scenario=literal(scenario.name),
        robot=literal(scenario.robot.name),
        version=__version__,
        ticks=len(run.ticks),
        size=ctypes.sizeof(memory),
        period=scenario.dt,
        bound=(
            f"iterations of the solver (`MOST_OF_ALL` or `TURNS` in `solver.c`), {ROUNDS} rounds"
            " for every distance"
        ),
        channels=table(names.channels),
        phases=table(names.phases),
        parameters=table([f"{name} = {numbers[place]:g}" for name, place in places.items()]),
    )
    made = {
        "controller.h": header(library, names, type(memory).__name__),
        "controller.c": source(library, names, kernel_of(memory).__name__, numbers, places),
        # A file of its own, as compilers that see megabytes of it look for what follows from them
        # for minutes.
        "initial.c": Template(template("initial.c")).substitute(
            declarations=library.declarations, value=library.initial
        ),
        "functions.c": with_variable(library.functions, _NUMBERS, numbers)
        if places
        else library.functions,
        "solver.c": core,
        "README.md": readme,
    }
    return made | {name: template(name) for name in TEMPLATES}, run.as_bytes()


def _recorded(scenario: Scenario, sizes: dict[str, int]) -> RecordingController:
    """Run the scenario with a fresh controller, recorded."""
    controller = our_controller(scenario)
    inputs, outputs = interface_types(sizes)
    recording = RecordingController(controller, controller.kinematic, inputs(), outputs())
    scenario.run(controller=recording)
    return recording


def _n_thrusters(scenario: Scenario) -> int:
    return len(scenario.robot.description.thrusters) if scenario.takes_forces else 0


def _require_c_form(scenario: Scenario) -> None:
    solver, mission = scenario.solver, scenario.mission
    problem = build_levels(scenario.robot, mission.hierarchy, scenario.dt, mission.beside_tasks)
    mission.check_quantities(problem.quantity_names)
    found = []
    if "controller" in scenario.own_parts:
        found.append(f"controller {scenario.own_parts['controller']}; the toolkit's own has")
    if not isinstance(solver, CompiledSolver):
        found.append(f"solver {type(solver).__name__}; LexicographicActiveSet and Icat have")
    if scenario.takes_forces and scenario.load is not None:
        found.append("load LoadLearning; a controller that learns none has")
    tasks = position_guards.without_c_form(
        scenario.robot, scenario.mission, scenario.dt, problem.quantity_names
    )
    found += [f"task {name}: {why}" for name, why in tasks.items()]
    if found:
        raise InvalidInput(f"no form in C: {'; '.join(found)}")


# A controller in C run from Python, and a record of what a controller of Python gets and gives.

_FILES = ("controller.h", "controller.c", "initial.c", "functions.c", "solver.c")
_INCLUDE = '#include "controller.h"\n'


class CController:
    """Exported controller, a callable ``(StateEstimate, t) -> Command``, at the beginning of its
    mission.
    """

    def __init__(self, folder: Path, sizes: dict[str, int], *, forces: bool) -> None:
        """folder: where the files of C are. sizes: of `interface_types`.

        forces: its commands have thrust and torque. Raises `InvalidInput` where the files cannot be
        compiled, or are of a controller for another robot or mission.
        """
        types: Any = interface_types(sizes)
        self._inputs, self._outputs = (kind() for kind in types)
        self._forces = forces
        library = _library(folder)
        size, *compiled = (ctypes.c_ulong * 3).in_dll(library, "CONTROLLER_SIZES")
        if compiled != [ctypes.sizeof(kind) for kind in types]:
            raise InvalidInput(
                f"{folder} is of a controller for another robot or mission; export this one"
            )
        self._memory = ctypes.create_string_buffer(size)
        self._step = library["controller_step"]
        self._step.restype = None
        library["controller_reset"](self._memory)

    def __call__(self, measurement: StateEstimate, t: float) -> Command:
        """Return the command for the tick at time t [s]."""
        exported_tick.write_measurement(self._inputs, measurement, t)
        self._step(self._memory, ctypes.byref(self._inputs), ctypes.byref(self._outputs))
        return exported_tick.command_in(self._outputs, forces=self._forces)


def interface_types(
    sizes: dict[str, int],
) -> tuple[type[ControllerInputs], type[ControllerOutputs]]:
    """Return the structures of inputs and outputs for n_q, n_v, n_joints, n_thrusters and
    n_quantities.
    """
    return structure_of(ControllerInputs, **sizes), structure_of(ControllerOutputs, **sizes)


def _library(folder: Path) -> ctypes.CDLL:
    try:
        header, *files = ((folder / name).read_text(encoding="utf-8") for name in _FILES)
    except OSError as error:
        raise InvalidInput(
            f"{folder} has no controller: {error.strerror}; `uvms-ocp export controller` writes one"
        ) from None
    source, *others = (text.replace(_INCLUDE, header) for text in files)
    path = compile_library(source, name="the exported controller", others=others)
    if path is None:
        raise InvalidInput(
            f"the controller in {folder} cannot be compiled; give a C compiler (CC, cc, gcc, clang)"
        )
    return loaded_library(path)


_TELEMETRY = ("phase", "freshness", "status", "viable_share")


class RecordingController:
    """Record of a controller: for each tick, `ControllerInputs` and `ControllerOutputs` as
    numbers.
    """

    def __init__(
        self,
        controller: Callable[[StateEstimate, float], Command],
        kinematic: KinematicController,
        inputs: ControllerInputs,
        outputs: ControllerOutputs,
    ) -> None:
        """inputs, outputs: structures through which the numbers go."""
        self.kinematic = kinematic
        """The layer below."""
        self._controller = controller
        self._inputs = inputs
        self._outputs = outputs
        self.ticks: list[list[float]] = []
        """(n,) each [in their units]."""

    def __call__(self, measurement: StateEstimate, t: float) -> Command:
        """Return the command for the tick at time t [s]."""
        exported_tick.write_measurement(self._inputs, measurement, t)
        command = self._controller(measurement, t)
        _write_command(self._outputs, command)
        self.ticks.append([*numbers_in(self._inputs), *numbers_in(self._outputs)])
        return command

    def as_bytes(self) -> bytes:
        """Return the ticks as little-endian doubles."""
        return np.array(self.ticks).astype("<f8").tobytes()


def _write_command(outputs: Any, command: Command) -> None:
    view(outputs.v)[:] = command.v
    if command.thrust is not None and command.torque is not None:
        outputs.thrust[: len(command.thrust)] = command.thrust.tolist()
        outputs.torque[: len(command.torque)] = command.torque.tolist()
    for name in ("hold", "stop", "brakes", "finished"):
        setattr(outputs, name, getattr(command, name))
    for name in _TELEMETRY:
        setattr(outputs, name, command.telemetry[name])
    quantities = command.telemetry["quantities"]
    outputs.quantities[: len(quantities)] = quantities.tolist()


def numbers_in(value: Any) -> Iterator[float]:
    """Yield all numbers of a structure, field after field."""
    if isinstance(value, ctypes.Structure):
        for name, *_ in value._fields_:
            yield from numbers_in(getattr(value, name))
    elif isinstance(value, ctypes.Array):
        for item in value:
            yield from numbers_in(item)
    else:
        yield value
