"""Export the controller of a scenario as files of C, and fly one of these in a scenario."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from uvms_ocp.checks import checked
from uvms_ocp.control import KinematicController, build_levels
from uvms_ocp.control.velocity.viability import without_c_form
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation.degraded_modes import CHANNELS
from uvms_ocp.export import c_files
from uvms_ocp.export.running import CController, RecordingController, interface_types
from uvms_ocp.record.output import claim_folder
from uvms_ocp.robot.shapes.gjk import ROUNDS
from uvms_ocp.scenario.scenario import Scenario, our_controller
from uvms_ocp.solvers import LexicographicActiveSet, Status
from uvms_ocp.solvers.hierarchy.tolerances import iteration_budget
from uvms_ocp.version import __version__

FILES = (
    "controller.h",
    "controller.c",
    "initial.c",
    "functions.c",
    "solver.c",
    "recorded.bin",
    "README.md",
    *c_files.TEMPLATES,
)
"""Files that `export_controller` writes."""


@checked
def export_controller(scenario: Scenario, folder: Path) -> list[Path]:
    """Write the controller of a scenario into `folder` as C99 that needs libm only, with a run to compare with.

    The scenario is run for that. Returns the files. Raises `InvalidInput` for what has no form in C, by its name, and
    `OutputError` where the folder cannot be written.
    """
    with claim_folder(folder, FILES) as claim:
        _require_c_form(scenario)
        texts, recorded = _texts(scenario)
        with claim.staged() as staging:
            for name, text in texts.items():
                (staging / name).write_text(text, encoding="utf-8")
            (staging / "recorded.bin").write_bytes(recorded)
        return claim.written()


@checked
def exported_controller(folder: Path) -> Callable[[Scenario], CController]:
    """Load the files of `export_controller`, for ``Scenario(controller=exported_controller(folder))``; needs a C compiler.

    Where it begins to run it raises `InvalidInput` for a folder without a controller, or with that of another mission.
    """

    def exported(scenario: Scenario) -> CController:
        kinematic = scenario.kinematic_controller()
        return CController(
            folder, c_files.interface_sizes(kinematic, _n_thrusters(scenario)), forces=scenario.takes_forces
        )

    return exported


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Run:
    """Recorded run of the exported controller."""

    recorded: bytes
    n_ticks: int


def _texts(scenario: Scenario) -> tuple[dict[str, str], bytes]:
    """Return the text of each file, and the recorded run."""
    controller = our_controller(scenario)
    kinematic = controller.kinematic
    sizes = c_files.interface_sizes(kinematic, _n_thrusters(scenario))
    memory, names, run = c_files.controller_memory(controller), _names(scenario, kinematic), _recorded(scenario, sizes)
    library = c_files.controller_library(memory, sizes)
    rows = sum(kinematic.problem.sizes)
    readme = c_files.template("README.md").format(
        scenario=scenario.name,
        robot=scenario.robot.name,
        version=__version__,
        ticks=run.n_ticks,
        size=ctypes.sizeof(memory),
        period=scenario.dt,
        bound=f"{iteration_budget(rows).most_of_all} iterations of the solver, {ROUNDS} rounds for every distance, "
        "whatever the numbers",
        channels=c_files.table(names.channels),
        phases=c_files.table(names.phases),
    )
    made = {
        "controller.h": c_files.header(library, names, type(memory).__name__),
        "controller.c": c_files.source(library, names, c_files.kernel_of(memory).__name__),
        "initial.c": c_files.initial(library),
        "functions.c": library.functions,
        "solver.c": c_files.solver_file(kinematic),
        "README.md": readme,
    }
    return made | {name: c_files.template(name) for name in c_files.TEMPLATES}, run.recorded


def _recorded(scenario: Scenario, sizes: dict[str, int]) -> _Run:
    controller = our_controller(scenario)
    inputs, outputs = interface_types(sizes)
    recording = RecordingController(controller, controller.kinematic, inputs(), outputs())
    scenario.run(controller=recording)
    return _Run(recorded=recording.as_bytes(), n_ticks=len(recording.ticks))


def _names(scenario: Scenario, controller: KinematicController) -> c_files.ControllerNames:
    return c_files.ControllerNames(
        phases=tuple(phase.name for phase in scenario.mission.all_phases),
        statuses=tuple(status.name for status in Status),
        quantities=tuple(controller.problem.quantity_names),
        channels=CHANNELS,
    )


def _n_thrusters(scenario: Scenario) -> int:
    return len(scenario.robot.description.thrusters) if scenario.takes_forces else 0


def _require_c_form(scenario: Scenario) -> None:
    solver, problem = scenario.solver, build_levels(scenario.robot, scenario.mission.hierarchy, scenario.dt)
    scenario.mission.check_quantities(problem.quantity_names)
    found = []
    if "controller" in scenario.own_parts:
        found.append(f"controller {scenario.own_parts['controller']}; the toolkit's own has")
    if not isinstance(solver, LexicographicActiveSet):
        found.append(f"solver {type(solver).__name__}; LexicographicActiveSet has")
    if scenario.takes_forces and scenario.load is not None:
        found.append("load LoadLearning; a controller that learns none has")
    tasks = without_c_form(scenario.robot, scenario.mission, scenario.dt, problem.quantity_names)
    found += [f"task {name}: {why}" for name, why in tasks.items()]
    if found:
        raise InvalidInput(f"no form in C: {'; '.join(found)}")
