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
from uvms_ocp.codegen.compile import EXACT, compile_library, loaded_library
from uvms_ocp.codegen.kernel_layout import Layout, arrays_of, structure_of, view
from uvms_ocp.codegen.kernels import CLibrary, c_library, number
from uvms_ocp.control import DynamicController, KinematicController, build_levels
from uvms_ocp.control.force.tick_functions import column_sizes
from uvms_ocp.control.velocity import position_guards, tick
from uvms_ocp.control.velocity.levels import numbers_of
from uvms_ocp.errors import InvalidInput, plain_line
from uvms_ocp.estimation.degraded_modes import CHANNELS
from uvms_ocp.export import tick as exported_tick
from uvms_ocp.export.names import export_name, functions_in, structures_in, with_prefix
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

_NUMBERS = "controller_numbers"
_TELEMETRY = ("phase", "freshness", "status", "viable_share")


# The files of a controller in C.

SOURCES = ("controller.h", "controller.c", "initial.c", "functions.c", "solver.c")
"""What is compiled, each name behind that of the export."""
FILES = (*SOURCES, "replay.c", "recorded.bin")
"""Files of an export whose names begin with its own."""
COMMON_FILES = ("CMakeLists.txt", "README.md")
"""Those whose names are the same for every export, as other programs look for them."""
_PLACEHOLDER = "NAME_"  # for the name of the export, in templates


def file_names(name: str) -> dict[str, str]:
    """Return the files of the export of that name, by what they are called without it."""
    return {file: f"{name}_{file}" for file in FILES} | {file: file for file in COMMON_FILES}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ControllerNames:
    """Name of the export, and those of the controller's phases, statuses and quantities."""

    export: str
    """What stands before every identifier, behind a ``_``."""
    phases: tuple[str, ...]
    """In the order of `ControllerOutputs.phase`."""
    statuses: tuple[str, ...]
    """In that of `ControllerOutputs.status`."""
    quantities: tuple[str, ...]
    """In that of `ControllerOutputs.quantities`."""
    channels: tuple[str, ...]
    """In that of `ControllerInputs.trust`."""

    @property
    def prefix(self) -> str:
        """What stands before every identifier."""
        return f"{self.export}_"

    def texts(self) -> dict[str, list[str]]:
        """Return them by the names of their arrays in C, as far as they can stand in a text there;
        never empty.
        """
        plain_texts = {
            name: [_plain(text) for text in getattr(self, name)]
            for name in ("phases", "statuses", "quantities", "channels")
        }
        return {
            f"{self.prefix}CONTROLLER_{name.upper()}": texts or [""]
            for name, texts in plain_texts.items()
        }


@dataclass(frozen=True, kw_only=True, slots=True)
class NamedSources:
    """Texts of a `CLibrary` and a solver with the name of the export before all that other files
    can see.
    """

    types: str
    """Structures."""
    kernels: str
    """Kernels, after types and declarations."""
    functions: str
    """CasADi functions, a file of its own."""
    numbers: str
    """Definition of their numbers, in another file."""
    declarations: str
    """Declarations of these functions, and of the solver."""
    initial: str
    """What initialises the memory."""
    solver: str
    """The solver, a file of its own."""

    @classmethod
    def of(cls, library: CLibrary, solver: str, prefix: str) -> NamedSources:
        """Name the texts: structures where kernels use them, functions where they are defined."""
        structures = structures_in(library.types)
        kernels = functions_in(library.kernels)
        defined = functions_in(library.functions) | functions_in(solver)
        declared = functions_in(library.declarations)
        written = {name for name in defined | declared if not name.startswith("casadi_")}
        # CasADi gives what all its functions share the name of their file.
        functions = {*written, "functions_", "numbers"}
        return cls(
            types=with_prefix(library.types, prefix, structures),
            kernels=with_prefix(library.kernels, prefix, structures | kernels),
            functions=with_prefix(library.functions, prefix, functions),
            numbers=with_prefix(library.numbers, prefix, functions),
            declarations=with_prefix(library.declarations, prefix, functions),
            initial=with_prefix(library.initial, prefix, functions),
            solver=with_prefix(solver, prefix, functions),
        )


def header(sources: NamedSources, names: ControllerNames, memory: str) -> str:
    """Return controller.h; memory: name of the structure of all that the controller remembers."""
    return Template(template("controller.h", names.export)).substitute(
        types=sources.types,
        memory=f"{names.prefix}{memory}",
        inputs=_documented(ControllerInputs, names.prefix),
        outputs=_documented(ControllerOutputs, names.prefix),
        names="\n".join(
            f"extern const char *const {name}[{len(texts)}];"
            for name, texts in names.texts().items()
        ),
    )


def source(
    sources: NamedSources,
    names: ControllerNames,
    kernel: str,
    numbers: list[float],
    places: Mapping[str, int],
) -> str:
    """Return controller.c, whose tick is the `kernel` of that name."""
    quoted = '", "'
    texts = (
        f'const char *const {name}[] = {{"{quoted.join(texts)}"}};'
        for name, texts in names.texts().items()
    )
    parameters = (
        f'{{"{_plain(name)}", {names.prefix}{_NUMBERS} + {k}}}, ' for name, k in places.items()
    )
    return Template(template("controller.c", names.export)).substitute(
        exact=EXACT,
        declarations=sources.declarations,
        kernels=sources.kernels,
        kernel=kernel,
        names="\n".join(texts),
        values=", ".join(number(value) or "0" for value in numbers),
        parameters="".join(parameters),
    )


def initial(sources: NamedSources, names: ControllerNames) -> str:
    """Return initial.c: what is remembered at first, and the numbers of `functions.c`.

    A file of its own, as compilers that see megabytes of it look for what follows from them for
    minutes.
    """
    return Template(template("initial.c", names.export)).substitute(
        exact=EXACT,
        declarations=sources.declarations,
        numbers=sources.numbers,
        value=sources.initial,
    )


def task_numbers(tasks: Sequence[Task], robot: Robot) -> tuple[list[float], dict[str, int]]:
    """Return the numbers of all tasks [as their fields] in the order of their rows, with the two
    that `with_numbers` appends.

    And, by ``task.field``, the places of those that may be changed in C, as rows alone depend on
    them: safety rules beside the rows are compiled with the others.
    """
    pairs = [(task, name) for task in tasks for name in numbers_of(task)]
    places = {
        f"{task.name}.{name}": k
        for k, (task, name) in enumerate(pairs)
        if _of_rows_alone(task, robot, name)
    }
    return [*(getattr(*pair) for pair in pairs), 0.0, 1.0], places


def _of_rows_alone(task: Task, robot: Robot, name: str) -> bool:
    """Check that a number of a task enters its rows alone: its rest altitude and position limit are
    the same for another value.
    """
    changed = copy(task)
    object.__setattr__(changed, name, getattr(task, name) + 1.0)
    rules = [
        (variant.rest_altitude, (limit := variant.position_limit(robot)) and limit.lower)
        for variant in (task, changed)
    ]
    return rules[0] == rules[1]


def template(file: str, name: str) -> str:
    """Return a template of the export with its name put in; other places may be left to be filled."""
    text = files("uvms_ocp.export").joinpath("templates", file).read_text(encoding="utf-8")
    return text.replace(_PLACEHOLDER, f"{name}_")


def table(names: Sequence[str]) -> str:
    """Return rows of a table in Markdown: place and name."""
    return "\n".join(f"| {place} | {literal(name)} |" for place, name in enumerate(names))


def literal(name: str) -> str:
    """Return a name as code in Markdown, in tables too, with no letter that would end it."""
    return f"`{re.sub('[`|]', '.', plain_line(name))}`"


def _plain(name: str) -> str:
    """Return a name without letters that would end a string, a comment or a cell of a table."""
    return "".join(c for c in plain_line(name) if c.isascii() and c not in '"\\?*/|')


def _documented(layout: type[Layout], prefix: str) -> str:
    lines = [
        f"   {name}: {text.replace('CONTROLLER_', f'{prefix}CONTROLLER_')}"
        for name, text in field_docs(layout).items()
    ]
    heading = f"/* {prefix}{layout.__name__}: {inspect.cleandoc(layout.__doc__ or '')}"
    return "\n".join([heading, *lines, "*/"])


def field_docs(layout: type[Layout]) -> Mapping[str, str]:
    """Return the docstring of each field of a layout, or of the next one that has one."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(layout))).body
    body = definition.body if isinstance(definition, ast.ClassDef) else []
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
    if hasattr(memory, "force"):
        return exported_tick.control_force
    return exported_tick.control_velocity


def controller_library(
    memory: Any, sizes: dict[str, int], variable: tuple[str, Sequence[float]] | None = None
) -> CLibrary:
    """Texts of a `controller_memory`, with these `interface_sizes`; variable: as for
    `c_library`.
    """
    return c_library((kernel_of(memory),), memory, interface_types(sizes), variable)


# Export the controller of a scenario as files of C, and fly one of these in a scenario.


@checked
def export_controller(
    scenario: Scenario, folder: Path | str, name: str | None = None
) -> list[Path]:
    """Write the controller of a scenario into `folder` as C99 that needs libm only, with a run to
    compare with.

    name: an identifier of C that stands before every identifier, target and file of it, so that
    several exports can be parts of one program; that of the scenario by default. The scenario is
    run for that. Returns the files. Raises `InvalidInput` for what has no form in C, by its name,
    for a name that is no identifier, and `OutputError` where the folder cannot be written.
    """
    prefix = export_name(name, scenario.name)
    called = file_names(prefix)
    with claim_folder(Path(folder), called.values()) as claim:
        _require_c_form(scenario)
        texts, recorded = _texts_controller(scenario, prefix)
        with claim.staged() as staging:
            for file, text in texts.items():
                (staging / called[file]).write_text(text, encoding="utf-8")
            (staging / called["recorded.bin"]).write_bytes(recorded)
        return claim.written()


@checked
def exported_controller(
    folder: Path | str, name: str | None = None
) -> Callable[[Scenario], CController]:
    """Load the files of `export_controller`, for
    ``Scenario(controller=exported_controller(folder))``; needs a C compiler.

    name: of the export, where files of several are in the folder. Where it begins to run it raises
    `InvalidInput` for a folder without a controller, or with that of another mission.
    """

    def exported(scenario: Scenario) -> CController:
        kinematic = scenario.kinematic_controller()
        return CController(
            Path(folder),
            name or _only_name(Path(folder)),
            interface_sizes(kinematic, _n_thrusters(scenario)),
            forces=scenario.takes_forces,
        )

    return exported


def _texts_controller(scenario: Scenario, name: str) -> tuple[dict[str, str], bytes]:
    """Return the text of each file of the export of that name, and the recorded run."""
    controller = our_controller(scenario)
    kinematic = controller.kinematic
    sizes = interface_sizes(kinematic, _n_thrusters(scenario))
    names = ControllerNames(
        export=name,
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
    variable = (f"{names.prefix}{_NUMBERS}", numbers) if places else None
    library = controller_library(memory, sizes, variable)
    sources = NamedSources.of(library, core, names.prefix)
    readme = template("README.md", name).format(
        scenario=literal(scenario.name),
        robot=literal(scenario.robot.name),
        version=__version__,
        ticks=len(run.ticks),
        size=ctypes.sizeof(memory),
        period=scenario.dt,
        bound=(
            f"iterations of the solver (`MOST_OF_ALL` or `TURNS` in `{name}_solver.c`), {ROUNDS}"
            " rounds for every distance"
        ),
        channels=table(names.channels),
        phases=table(names.phases),
        parameters=table([f"{key} = {numbers[place]:g}" for key, place in places.items()]),
    )
    texts = {
        "controller.h": header(sources, names, type(memory).__name__),
        "controller.c": source(sources, names, kernel_of(memory).__name__, numbers, places),
        "initial.c": initial(sources, names),
        "functions.c": EXACT + sources.functions,
        "solver.c": EXACT + sources.solver,
        "replay.c": template("replay.c", name),
        "CMakeLists.txt": template("CMakeLists.txt", name),
        "README.md": readme,
    }
    return texts, run.as_bytes()


def _recorded(scenario: Scenario, sizes: dict[str, int]) -> RecordingController:
    """Run the scenario with a fresh controller, recorded."""
    controller = our_controller(scenario)
    inputs, outputs = interface_types(sizes)
    recording = RecordingController(controller, controller.kinematic, inputs(), outputs())
    scenario.run(controller=recording)
    return recording


def _n_thrusters(scenario: Scenario) -> int:
    if scenario.takes_forces:
        return len(scenario.robot.description.thrusters)
    return 0


def _require_c_form(scenario: Scenario) -> None:
    solver, mission = scenario.solver, scenario.mission
    problem = build_levels(scenario.robot, mission.hierarchy, scenario.dt, mission.beside_tasks)
    mission.check_quantities(problem.quantity_names)
    problems = []
    if "controller" in scenario.own_parts:
        problems.append(f"controller {scenario.own_parts['controller']}; the toolkit's own has")
    if not isinstance(solver, CompiledSolver):
        problems.append(f"solver {type(solver).__name__}; LexicographicActiveSet and Icat have")
    if scenario.takes_forces and scenario.load is not None:
        problems.append("load LoadLearning; a controller that learns none has")
    tasks = position_guards.without_c_form(
        scenario.robot, scenario.mission, scenario.dt, problem.quantity_names
    )
    problems += [f"task {name}: {why}" for name, why in tasks.items()]
    if problems:
        raise InvalidInput(f"no form in C: {'; '.join(problems)}")


# A controller in C run from Python, and a record of what a controller of Python gets and gives.


class CController:
    """Exported controller, a callable ``(StateEstimate, t) -> Command``, at the beginning of its
    mission.
    """

    def __init__(self, folder: Path, name: str, sizes: dict[str, int], *, forces: bool) -> None:
        """folder: where the files of C are. name: of the export. sizes: of `interface_types`.

        forces: its commands have thrust and torque. Raises `InvalidInput` where the files cannot be
        compiled, or are of a controller for another robot or mission.
        """
        types: Any = interface_types(sizes)
        self._inputs, self._outputs = (kind() for kind in types)
        self._told = arrays_of(self._outputs)
        self._forces = forces
        library = _library(folder, name)
        size, *compiled = (ctypes.c_ulong * 3).in_dll(library, f"{name}_CONTROLLER_SIZES")
        if compiled != [ctypes.sizeof(kind) for kind in types]:
            raise InvalidInput(
                f"{folder} is of a controller for another robot or mission; export this one"
            )
        self._memory = ctypes.create_string_buffer(size)
        self._step = library[f"{name}_controller_step"]
        self._step.restype = None
        library[f"{name}_controller_reset"](self._memory)

    def __call__(self, estimate: StateEstimate, t: float) -> Command:
        """Return the command for the tick at time t [s]."""
        exported_tick.write_measurement(self._inputs, estimate, t)
        self._step(self._memory, ctypes.byref(self._inputs), ctypes.byref(self._outputs))
        return exported_tick.command_in(self._outputs, self._told, forces=self._forces)


def interface_types(
    sizes: dict[str, int],
) -> tuple[type[ControllerInputs], type[ControllerOutputs]]:
    """Return the structures of inputs and outputs for n_q, n_v, n_joints, n_thrusters and
    n_quantities.
    """
    return structure_of(ControllerInputs, **sizes), structure_of(ControllerOutputs, **sizes)


def _only_name(folder: Path) -> str:
    """Return the name of the export in a folder. Raises `InvalidInput` for none, and for several."""
    names = sorted(
        path.name.removesuffix("_controller.h") for path in folder.glob("*_controller.h")
    )
    if not names:
        raise InvalidInput(f"{folder} has no controller; `uvms-ocp export controller` writes one")
    if len(names) > 1:
        raise InvalidInput(
            f"{folder} has {len(names)} controllers; give the name of one: {', '.join(names)}"
        )
    return names[0]


def _library(folder: Path, name: str) -> ctypes.CDLL:
    called = file_names(name)
    try:
        header, *files = ((folder / called[file]).read_text(encoding="utf-8") for file in SOURCES)
    except OSError as error:
        raise InvalidInput(
            f"{folder} has no controller {name}: {error.strerror}; `uvms-ocp export controller`"
            " writes one"
        ) from None
    include = f'#include "{called["controller.h"]}"\n'
    source, *others = (text.replace(include, header) for text in files)
    path = compile_library(source, name="the exported controller", others=others)
    if path is None:
        raise InvalidInput(
            f"the controller in {folder} cannot be compiled; give a C compiler (CC, cc, gcc, clang)"
        )
    return loaded_library(path)


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

    def __call__(self, estimate: StateEstimate, t: float) -> Command:
        """Return the command for the tick at time t [s]."""
        exported_tick.write_measurement(self._inputs, estimate, t)
        command = self._controller(estimate, t)
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
