"""Options that commands share, and the scenario that they describe."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from uvms_ocp.control.velocity.kinematic import HierarchySolver
from uvms_ocp.errors import NameNotFound, OutputError
from uvms_ocp.robot.loading import list_robots
from uvms_ocp.scenario.cases import SCENARIOS
from uvms_ocp.scenario.own_code import load_scenario, own_code
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.own_parts import PLANTS
from uvms_ocp.solvers import Icat, LexicographicActiveSet, LexicographicQp

# Options that several commands share, written once as fields of a dataclass.


def expand_options(command: Callable[..., None]) -> Callable[..., None]:
    """A command whose first parameter is a dataclass, as one that has the fields of it as options of its own.

    typer reads the options of a command from its signature: first those of the dataclass, then the others.
    """
    first, *own = signature(command, eval_str=True).parameters.values()
    group: Any = first.annotation
    hints = get_type_hints(group, include_extras=True)
    shared = [
        Parameter(field.name, Parameter.KEYWORD_ONLY, default=field.default, annotation=hints[field.name])
        for field in fields(group)
    ]

    @wraps(command)
    def spread(**options: Any) -> None:
        values = {parameter.name: options.pop(parameter.name) for parameter in shared}
        command(group(**values), **options)

    parameters = [*shared, *(parameter.replace(kind=Parameter.KEYWORD_ONLY) for parameter in own)]
    spread.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    spread.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    return spread


def defaults_of(kind: type[Any]) -> dict[str, Any]:
    """Defaults of the fields of a dataclass that have one, for options that are to have the same."""
    return {field.name: field.default for field in fields(kind) if field.default is not MISSING}


# Options that commands share, and the scenario that they describe.

SOLVERS: dict[str, type[HierarchySolver]] = {
    "active_set": LexicographicActiveSet,
    "lexqp": LexicographicQp,
    "icat": Icat,
}
_OLD_SOLVER_NAMES = {"lexls": "active_set"}
BAD_INPUT, NOT_COMPLETED = 2, 3  # exit codes


def folder(words: str | Path) -> Path:
    """The folder of that name.

    Raises `OutputError` for no name, which would mean the working directory, and for line breaks and the like, which would
    be refused only when results are written.
    """
    if not str(words).strip():
        raise OutputError(f"{words!r} names no folder for the results; give one, or . for the working directory")
    if any(letter < " " for letter in str(words)):
        raise OutputError(f"{words!r} has control characters; give a folder without")
    return Path(words)


SCENARIO_HELP = (
    "Scenario, see `uvms-ocp list`, or your own: FILE.py, FILE.py:NAME or PACKAGE.MODULE:NAME. "
    "Loading Python code runs it: give only what you trust."
)


def completing(*names: str) -> Callable[[str], list[str]]:
    """Return the names that a shell may end a word with."""
    return lambda incomplete: [name for name in names if name.startswith(incomplete)]


Name = Annotated[
    str,
    typer.Argument(metavar="SCENARIO", help=SCENARIO_HELP, autocompletion=completing(*SCENARIOS)),
]
RobotName = Annotated[
    str | None,
    typer.Option(
        help="Robot, see `uvms-ocp list`, a URDF or a folder with robot.urdf; default: the scenario's.",
        autocompletion=completing(*list_robots()),
    ),
]
Hydrodynamics = Annotated[
    str | None, typer.Option(metavar="YAML", help="Hydrodynamics file of the robot; default: the one beside its URDF.")
]
PlantName = Annotated[
    str | None,
    typer.Option(help=f"Plant: {', '.join(PLANTS)}; default: the scenario's.", autocompletion=completing(*PLANTS)),
]
SolverName = Annotated[
    str | None,
    typer.Option(
        help=f"Hierarchy solver: {', '.join(SOLVERS)}; default: the scenario's.",
        autocompletion=completing(*SOLVERS),
    ),
]
CurrentVelocity = Annotated[
    tuple[float, float, float] | None,
    typer.Option(metavar="X Y Z", help="Uniform current in W [m/s]; default: the scenario's."),
]
Seabed = Annotated[
    float | None, typer.Option(metavar="Z", help="Height of the floor in W [m]; default: the scenario's.")
]
Seed = Annotated[int | None, typer.Option(help="Seed of everything random.")]
Noise = Annotated[bool | None, typer.Option("--noise/--no-noise", help="Sensors with noise, rates and delays.")]
Duration = Annotated[float | None, typer.Option(metavar="S", help="Time limit of the mission [s].")]
Faults = Annotated[
    list[str] | None,
    typer.Option(
        metavar="TEXT", help="What goes wrong, TARGET:KIND=VALUES@ONSET-END, such as altimeter:frozen@8; several times."
    ),
]
Out = Annotated[Path | None, typer.Option(metavar="DIR", parser=folder, help="Folder for the results.")]
Json = Annotated[bool, typer.Option("--json", help="Print the report on stdout, the rest on stderr.")]


def given(**options: Any) -> dict[str, Any]:
    """The options that were given on the command line."""
    return {name: value for name, value in options.items() if value is not None}


def build_scenario(name: str, options: Mapping[str, Any], solver: str | None = None) -> Scenario:
    """The scenario with the options of the command line.

    Raises `NameNotFound` for an unknown scenario or solver, and `UvmsError` where an option is wrong.
    """
    if own_code(name) is None and name not in SCENARIOS:
        raise NameNotFound("scenario", name, SCENARIOS)
    return load_scenario(name, with_solver(options, solver), SCENARIOS)


def with_solver(options: Mapping[str, Any], solver: str | None) -> Mapping[str, Any]:
    """The options with the solver of that name, if one is given. Raises `NameNotFound` for an unknown one."""
    if solver is None:
        return options
    if solver in _OLD_SOLVER_NAMES:
        typer.echo(f"--solver {solver} is now --solver {_OLD_SOLVER_NAMES[solver]}", err=True)
        solver = _OLD_SOLVER_NAMES[solver]
    if solver not in SOLVERS:
        raise NameNotFound("solver", solver, SOLVERS)
    return {**options, "solver": SOLVERS[solver]()}


def solver_name(solver: HierarchySolver) -> str:
    """The name by which the command line knows a solver of that kind."""
    return next((name for name, kind in SOLVERS.items() if kind is type(solver)), label(type(solver).__name__))


def default_folder(parts: Sequence[str], options: Mapping[str, Any]) -> Path:
    """Where the results go unless told otherwise: what was asked for is part of the name, so that nothing else is there."""
    return Path("uvms_runs", "-".join((*parts, *(_word(name, value) for name, value in options.items()))))


def _word(name: str, value: Any) -> str:
    if isinstance(value, bool):
        return name if value else f"no_{name}"
    if name == "faults":
        return "-".join(re.sub(r"\W", "_", str(fault).replace("-", "to").replace(".", "p")) for fault in value)
    if isinstance(value, tuple):
        return name + "_".join(map(str, value))
    if name in ("robot", "hydrodynamics"):
        return label(str(value))
    return f"{name}{value}"


def label(words: str) -> str:
    """A name for folders, of a name, a file or code of one's own."""
    place, _, attribute = words.partition(":")
    plain = re.sub(
        r"[^\w.]+", "_", "-".join(filter(None, (Path(place).stem if "." in place else Path(place).name, attribute)))
    )
    return plain.strip("_") or "run"
