"""Export a scenario's controller, with missions, tasks and gains, as files of C."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from uvms_ocp.checks import checked
from uvms_ocp.codegen.c_text import EXACT
from uvms_ocp.codegen.kernel_layout import structure_of
from uvms_ocp.codegen.kernels import CLibrary, c_library
from uvms_ocp.control import DynamicController, KinematicController, build_levels
from uvms_ocp.control.velocity import position_guards, tick
from uvms_ocp.errors import InvalidInput
from uvms_ocp.export import tick as exported_tick
from uvms_ocp.export.c_controller import (
    CController,
    RecordingController,
    interface_types,
    only_name,
)
from uvms_ocp.export.c_files import (
    NUMBERS,
    ControllerNames,
    NamedSources,
    file_names,
    header,
    initial,
    literal,
    source,
    table,
    task_numbers,
    template,
    with_digest,
)
from uvms_ocp.export.names import export_name
from uvms_ocp.record.output import claim_folder
from uvms_ocp.robot.channels import CHANNELS
from uvms_ocp.robot.dimensions import Dimensions, dimensions_of
from uvms_ocp.robot.shapes.gjk import ROUNDS
from uvms_ocp.scenario.part_factories import our_controller
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.solvers.hierarchy import solution
from uvms_ocp.solvers.hierarchy.core import CompiledSolver, external_core
from uvms_ocp.version import __version__


def interface_dimensions(controller: KinematicController, n_thrusters: int) -> Dimensions:
    """Return the dimensions of `ControllerInputs` and `ControllerOutputs`."""
    return replace(
        dimensions_of(controller.robot),
        n_thrusters=n_thrusters,
        n_quantities=len(controller.problem.quantity_names),
    )


def controller_memory(controller: KinematicController | DynamicController, core: str) -> Any:
    """Make a `VelocityController` at the beginning of the mission of a fresh one, or a
    `ForceController` where it has that layer.

    core: source of the solver, as `CompiledSolver.core_source`. Raises `InvalidInput` without a C
    compiler.
    """
    kinematic = controller.kinematic
    velocity = tick.velocity_controller(kinematic.memory, kinematic.problem, external_core(core))
    if velocity is None:
        raise InvalidInput(
            "the controller cannot be written without a C compiler; give one (CC, cc, gcc, clang)"
        )
    if not isinstance(controller, DynamicController):
        return velocity
    memory: Any = structure_of(
        exported_tick.ForceController, velocity=type(velocity), force=type(controller.memory)
    )()
    memory.velocity = velocity
    memory.force = controller.memory
    return memory


def kernel_of(memory: Any) -> Callable[..., None]:
    """Return the tick of a `controller_memory`."""
    if hasattr(memory, "force"):
        return exported_tick.control_force
    return exported_tick.control_velocity


def controller_library(
    memory: Any, dimensions: Dimensions, variable: tuple[str, Sequence[float]] | None = None
) -> CLibrary:
    """Write a `controller_memory` and its tick in C, with these `interface_dimensions`; variable: as for
    `c_library`.
    """
    return c_library((kernel_of(memory),), memory, interface_types(dimensions), variable)


@checked
def export_controller(
    scenario: Scenario, folder: Path | str, name: str | None = None
) -> list[Path]:
    """Write the controller of a scenario into `folder` as C99 that needs libm only, with a run to
    compare with.

    name: an identifier of C that stands before every identifier, target and file of it, so that
    several exports can be parts of one program, with a name each; that of the scenario by default.
    The scenario is run for that. Returns the files. Raises `InvalidInput` for what has no form in C, by its name,
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
        path = Path(folder)
        dimensions = interface_dimensions(scenario.kinematic_controller(), _n_thrusters(scenario))
        return CController(path, name or only_name(path), dimensions, forces=scenario.takes_forces)

    return exported


def _texts_controller(scenario: Scenario, name: str) -> tuple[dict[str, str], bytes]:
    """Return the text of each file of the export of that name, and the recorded run."""
    controller = our_controller(scenario)
    kinematic = controller.kinematic
    dimensions = interface_dimensions(kinematic, _n_thrusters(scenario))
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
    run = _recorded(scenario, dimensions)
    variable = None
    if places:
        variable = (f"{names.symbol_prefix}{NUMBERS}", numbers)
    library = controller_library(memory, dimensions, variable)
    sources = NamedSources.of(library, core, names)
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
    return with_digest(texts, name), run.as_bytes()


def _recorded(scenario: Scenario, dimensions: Dimensions) -> RecordingController:
    """Run the scenario with a fresh controller, recorded."""
    controller = our_controller(scenario)
    inputs, outputs = interface_types(dimensions)
    recording = RecordingController(controller, controller.kinematic, inputs(), outputs())
    scenario.run(controller=recording)
    return recording


def _n_thrusters(scenario: Scenario) -> int:
    if scenario.takes_forces:
        return len(scenario.robot.description.thrusters)
    return 0


def _require_c_form(scenario: Scenario) -> None:
    solver = scenario.solver
    mission = scenario.mission
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
    problems += [f"task {name}: {reason}" for name, reason in tasks.items()]
    if problems:
        raise InvalidInput(f"no form in C: {'; '.join(problems)}")
