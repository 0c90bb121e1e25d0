"""Options that commands share, and the scenario that they describe."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from uvms_ocp.cli.result_folders import label, named_folder
from uvms_ocp.errors import InvalidInput, require_known
from uvms_ocp.record.meta_values import PLANTS
from uvms_ocp.robot.loading import list_robots
from uvms_ocp.solvers import Icat, LexicographicActiveSet, LexicographicQp

if TYPE_CHECKING:  # commands that plan need neither, and would wait a tenth of a second for them
    from uvms_ocp.control.velocity.kinematic import HierarchySolver
    from uvms_ocp.scenario.scenario import Scenario

SOLVERS: dict[str, type[HierarchySolver]] = {
    "active_set": LexicographicActiveSet,
    "lexqp": LexicographicQp,
    "icat": Icat,
}
_OLD_SOLVER_NAMES = {"lexls": "active_set"}

SCENARIO_HELP = (
    "Scenario, see `uvms-ocp list`, or your own: FILE.py, FILE.py:NAME or PACKAGE.MODULE:NAME. "
    "Loading Python code runs it: give only what you trust."
)

_Words = list[str] | None  # of an option that may be given several times
_TOOL = "Frame of the tool; several times for several arms."

CurrentVelocity = Annotated[
    tuple[float, float, float] | None,
    typer.Option(metavar="X Y Z", help="Uniform current in W [m/s]; default: the scenario's."),
]
Seabed = Annotated[
    float | None,
    typer.Option(metavar="Z", help="Height of the floor in W [m]; default: the scenario's."),
]

Seed = Annotated[int | None, typer.Option(help="Seed of everything random.")]
Noise = Annotated[
    bool | None, typer.Option("--noise/--no-noise", help="Sensors with noise, rates and delays.")
]
Duration = Annotated[float | None, typer.Option(metavar="S", help="Time limit of the mission [s].")]
Faults = Annotated[
    _Words,
    typer.Option(
        metavar="TEXT",
        help="What goes wrong, TARGET:KIND=VALUES@ONSET-END, such as altimeter:frozen@8; several times.",
    ),
]

Json = Annotated[
    bool, typer.Option("--json", help="Print the report on stdout, the rest on stderr.")
]


def among(names: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Return a function that completes a word of the shell to those of the names that begin with
    it.

    names: called only where a shell completes a word.
    """

    def complete(incomplete: str) -> list[str]:
        return [name for name in names() if name.startswith(incomplete)]

    return complete


def _scenarios() -> Mapping[str, Callable[..., Scenario]]:
    from uvms_ocp.scenario.cases import SCENARIOS

    return SCENARIOS


Name = Annotated[
    str, typer.Argument(metavar="SCENARIO", help=SCENARIO_HELP, autocompletion=among(_scenarios))
]
RobotName = Annotated[
    str | None,
    typer.Option(
        help="Robot, see `uvms-ocp list`, a URDF or a folder with robot.urdf; default: the scenario's.",
        autocompletion=among(list_robots),
    ),
]


@dataclass(frozen=True, kw_only=True, slots=True)
class RobotFiles:
    """Options for reading the files of a robot.

    Those that are not given are as the robot's hydrodynamics.yaml says, under the same names.
    """

    hydrodynamics: Annotated[
        str | None,
        typer.Option(
            metavar="YAML",
            help="Hydrodynamics file of the robot; default: the one beside its URDF.",
        ),
    ] = None
    base: Annotated[
        str | None,
        typer.Option(
            metavar="free_flyer|fixed", help="Whether it floats; default: what its file says."
        ),
    ] = None
    packages: Annotated[
        _Words, typer.Option(metavar="DIR", help="Where package:// meshes are; repeatable.")
    ] = None
    meshes: Annotated[
        bool | None,
        typer.Option("--meshes/--no-meshes", help="Whether shapes that are meshes are read."),
    ] = None
    mimic: Annotated[
        str | None,
        typer.Option(
            metavar="coupled|free|fixed",
            help="Joints that mimic another: one with it, of their own, or fixed.",
        ),
    ] = None
    lock: Annotated[
        _Words,
        typer.Option(metavar="JOINT[=Q]", help="Fix a joint, at 0 unless given; repeatable."),
    ] = None
    drop: Annotated[
        _Words,
        typer.Option(metavar="LINK", help="Leave out a link and what hangs on it; repeatable."),
    ] = None
    tool_link: Annotated[
        _Words, typer.Option("--tool", "--tool-link", metavar="LINK", help=_TOOL)
    ] = None
    altimeter: Annotated[
        str | None,
        typer.Option(metavar="LINK", help="Frame of the range sensor, which looks along its -z."),
    ] = None
    dvl: Annotated[
        str | None, typer.Option(metavar="LINK", help="Frame of the Doppler velocity log.")
    ] = None

    @property
    def loading(self) -> dict[str, Any]:
        """Arguments of `uvms_ocp.load_robot` from the options that were given.

        Raises `InvalidInput` for a position of a locked joint that is no number.
        """
        folders = [str(Path(folder).resolve()) for folder in self.packages or ()]
        positions = dict(_locked_joint(words) for words in self.lock or ())
        return given_options(
            base=self.base,
            package_dirs=folders or None,
            meshes=self.meshes,
            mimic=self.mimic,
            lock=positions or None,
            drop=self.drop or None,
            tool=self.tool_link or None,
            altimeter=self.altimeter,
            dvl=self.dvl,
        )

    @property
    def options(self) -> dict[str, Any]:
        """Options of a scenario for the robot's files: those that were given, as keyword arguments."""
        return given_options(hydrodynamics=self.hydrodynamics, loading=self.loading or None)


def _locked_joint(words: str) -> tuple[str, float]:
    """Return name and position of a joint from ``JOINT`` or ``JOINT=POSITION``."""
    name, equals, value = words.partition("=")
    try:
        position = float(value) if equals else 0.0
    except ValueError:
        raise InvalidInput(
            f"--lock {words!r}: give JOINT or JOINT=POSITION, such as propeller_joint=0.5"
        ) from None
    return name, position


@dataclass(frozen=True, kw_only=True, slots=True)
class PlannedRobotFiles(RobotFiles):
    """Files of a robot whose motion is planned: without ``--tool``, which is the goal there."""

    tool_link: Annotated[_Words, typer.Option(metavar="LINK", help=_TOOL)] = None


AS_WRITTEN = RobotFiles()
"""No option: the robot is as its own files say."""


PlantName = Annotated[
    str | None,
    typer.Option(
        help=f"Plant: {', '.join(PLANTS)}; default: the scenario's.",
        autocompletion=among(lambda: PLANTS),
    ),
]
SolverName = Annotated[
    str | None,
    typer.Option(
        help=f"Hierarchy solver: {', '.join(SOLVERS)}; default: the scenario's.",
        autocompletion=among(lambda: SOLVERS),
    ),
]


@dataclass(frozen=True, kw_only=True, slots=True)
class ScenarioOptions(RobotFiles):
    """Robot, plant and water in place of the scenario's."""

    robot: RobotName = None
    plant: PlantName = None
    current: CurrentVelocity = None
    seabed: Seabed = None

    @property
    def chosen(self) -> dict[str, Any]:
        """Options of a scenario for its robot, plant and water: those that were given, as keyword
        arguments.
        """
        return given_options(
            robot=self.robot,
            **self.options,
            plant=self.plant,
            current=self.current,
            seabed=self.seabed,
        )


AS_IT_IS = ScenarioOptions()
"""No option: robot, plant and water are those of the scenario."""

Out = Annotated[
    Path | None, typer.Option(metavar="DIR", parser=named_folder, help="Folder for the results.")
]


def given_options(**options: Any) -> dict[str, Any]:
    """Return the options that were given on the command line."""
    return {name: value for name, value in options.items() if value is not None}


def build_scenario(name: str, options: Mapping[str, Any], solver: str | None = None) -> Scenario:
    """Build the scenario with the options of the command line.

    Raises `NameNotFound` for an unknown scenario or solver, and `UvmsError` where an option is
    wrong.
    """
    from uvms_ocp.scenario.own_code import load_scenario, own_code

    known = {} if own_code(name) else _scenarios()
    return load_scenario(name, with_solver(options, solver), known)


def with_solver(options: Mapping[str, Any], solver: str | None) -> Mapping[str, Any]:
    """Return the options with the solver of that name, if there is one.

    Raises `NameNotFound` for an unknown name.
    """
    if solver is None:
        return options
    if solver in _OLD_SOLVER_NAMES:
        typer.echo(f"--solver {solver} is now --solver {_OLD_SOLVER_NAMES[solver]}", err=True)
        solver = _OLD_SOLVER_NAMES[solver]
    require_known("solver", solver, SOLVERS)
    return {**options, "solver": SOLVERS[solver]()}


def solver_name(solver: HierarchySolver) -> str:
    """Return the name by which the command line knows a solver of that kind."""
    for name, kind in SOLVERS.items():
        if kind is type(solver):
            return name
    return label(type(solver).__name__)
