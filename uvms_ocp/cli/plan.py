"""``plan curve``, ``plan ocp`` and ``plan mission``: plan a motion among obstacles, or a whole
mission.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from uvms_ocp.cli import INTERRUPTED, NOT_COMPLETED, options as opt
from uvms_ocp.cli.printing import busy, console_of, print_json, print_paths, table_of
from uvms_ocp.cli.run import SCENE, drawer, drawings_of
from uvms_ocp.errors import InvalidInput, plain_line
from uvms_ocp.interrupts import Interrupted
from uvms_ocp.ocp import OcpRequest, OcpStatus, solve_ocp
from uvms_ocp.planning.request import (
    AXES,
    Goal,
    PlanRequest,
    PostureGoal,
    ToolGoal,
    Triple,
    plan_path,
)
from uvms_ocp.planning.soft_collision import PlanStatus
from uvms_ocp.record.output import RECORD, claim_folder
from uvms_ocp.record.record import Record
from uvms_ocp.report.planned_motion import motion_record, ocp_record, ocp_report, plan_report
from uvms_ocp.robot import Robot, loading
from uvms_ocp.robot.shapes.obstacles import Obstacle, parse_obstacle, read_obstacles
from uvms_ocp.solvers.nlp.level_solver import PLUGINS, NlpOptions
from uvms_ocp.solvers.nlp.solve_monitor import IterationReport
from uvms_ocp.viz.series import PLAN_NAMES

# Options of every plan: where it starts, where it goes, and what stands in the way.

_Clearance = Annotated[
    float, typer.Option(metavar="M", help="Distance wanted from obstacles, and between links [m].")
]

_FILES = ("report.json", "plan.npz", "plan.csv", "plan.json", RECORD, "scene.html")
"""Files that a plan may write beside its figures; which of them depends on the method and the
outcome.
"""

Progress = Callable[[str], None]
"""Told how far the search is, to show while it goes on."""

_COLUMNS = ("name", "begin_s", "end_s")
_NLP = opt.defaults_of(NlpOptions)

_PERIOD = 0.02  # [s] between rows of plan.csv
_CURVE = opt.defaults_of(PlanRequest)
_OCP = opt.defaults_of(OcpRequest)

_AS_WRITTEN = opt.PlannedRobotFiles()
_Axes = Annotated[
    str, typer.Option(help=f"Planned axes, of {', '.join(AXES)}; level: no roll, no pitch.")
]


@dataclass(frozen=True, kw_only=True, slots=True)
class MotionOptions:
    """Options of the command line that say what is planned."""

    tool: Annotated[
        Triple | None, typer.Option(metavar="X Y Z", help="Goal of the tool in W [m].")
    ] = None
    tool_rpy: Annotated[
        Triple | None, typer.Option(metavar="R P Y", help="Its orientation; default: any.")
    ] = None
    joint: Annotated[
        list[str] | None, typer.Option(metavar="NAME=Q", help="Goal of a joint; repeatable.")
    ] = None
    to: Annotated[Triple | None, typer.Option(metavar="X Y Z", help="Goal of the vehicle [m].")] = (
        None
    )
    to_rpy: Annotated[
        Triple | None, typer.Option(metavar="R P Y", help="Goal of its attitude [rad].")
    ] = None
    position: Annotated[
        Triple | None, typer.Option(metavar="X Y Z", help="Start of the vehicle [m].")
    ] = None
    rpy: Annotated[
        Triple | None, typer.Option(metavar="R P Y", help="Attitude at the start [rad].")
    ] = None
    sphere: Annotated[
        list[str] | None, typer.Option(metavar="X,Y,Z,R", help="Obstacle; repeatable.")
    ] = None
    box: Annotated[
        list[str] | None, typer.Option(metavar="X,Y,Z,LX,LY,LZ", help="Obstacle; repeatable.")
    ] = None
    obstacles: Annotated[Path | None, typer.Option(metavar="YAML", help="File of obstacles.")] = (
        None
    )
    robot: Annotated[str, typer.Option(help="Robot, see `uvms-ocp list`, a URDF or a folder.")] = (
        "girona_maris7_full"
    )
    clearance: _Clearance = opt.defaults_of(PlanRequest)["clearance"]
    link_clearance: Annotated[
        float | None, typer.Option(metavar="M", help="Between links [m]; default: the same.")
    ] = None

    def asked(self, files: opt.RobotFiles) -> dict[str, Any]:
        """Return the fields that requests of all methods have.

        Raises `InvalidInput` for goals that are none, several or not the robot's, a start that is
        not valid and obstacles that cannot be read, and `NameNotFound` for an unknown robot.
        """
        robot = loading.robot_called(self.robot, files.hydrodynamics, files.loading)
        self._check_vehicle(robot)
        return {
            "robot": robot,
            "start": robot.configuration(position=self.position, rpy=self.rpy),
            "goal": self._goal(),
            "obstacles": self._obstacles(),
            "clearance": self.clearance,
            "link_clearance": self.link_clearance,
        }

    def _check_vehicle(self, robot: Robot) -> None:
        poses = {"to": self.to, "to-rpy": self.to_rpy, "position": self.position, "rpy": self.rpy}
        for name in opt.given(**poses):
            if not robot.n_vehicle:
                raise InvalidInput(
                    f"--{name}: {robot.name} has no free vehicle pose; give --joint NAME=Q with any"
                    f" of {', '.join(robot.joint_names)}, or --tool"
                )

    def _goal(self) -> Goal:
        """Return the one goal that was given."""
        has_posture = bool(self.joint or self.to or self.to_rpy)
        if (self.tool is None) != has_posture or (self.tool is None and self.tool_rpy is not None):
            raise InvalidInput(
                "give one goal: --tool, with or without --tool-rpy, or any of --to, --to-rpy and"
                " --joint"
            )
        if self.tool is not None:
            return ToolGoal(position=self.tool, rpy=self.tool_rpy)
        return PostureGoal(
            position=self.to, rpy=self.to_rpy, joints=dict(map(_joint_goal, self.joint or ()))
        )

    def _obstacles(self) -> tuple[Obstacle, ...]:
        obstacles = list[Obstacle]()
        if self.obstacles:
            obstacles += read_obstacles(self.obstacles)
        for shape, texts in (("sphere", self.sphere), ("box", self.box)):
            for i, words in enumerate(texts or (), 1):
                obstacles.append(parse_obstacle(shape, words, f"{shape}{i}"))
        return tuple(obstacles)


def _joint_goal(words: str) -> tuple[str, float]:
    name, _, value = words.partition("=")
    try:
        return name, float(value)
    except ValueError:
        raise InvalidInput(f"--joint {words!r}: give NAME=VALUE, such as joint2=0.5") from None


# What a plan of any method writes and prints.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlanOutput:
    """A plan of any method, ready to be written."""

    robot: Robot
    report: dict[str, Any]
    record: Record | None
    """Record of the motion; None where there is none."""
    good: bool
    """True where the goal is reached and nothing touches."""
    stopped: bool = False
    """True where Ctrl-C ended the search: the best plan so far is written."""
    save: Callable[[Path], object] | None
    """Function that writes what only this method has into a folder; None where there is nothing."""
    show: Callable[[Console, PlanOutput], object]
    """Function that prints the figures of the plan."""

    def write(self, folder: Path) -> list[str]:
        """Write the report always, the rest where there is any, but for drawings; returns names of
        what was written.
        """
        (folder / "report.json").write_text(json.dumps(self.report, indent=2) + "\n")
        if self.save is not None:
            self.save(folder)
        if self.record is not None:
            self.record.save(folder / RECORD)
        return [path.name for path in folder.iterdir()]


def make_and_write_plan(make: Callable[[Progress], PlanOutput], out: Path, as_json: bool) -> None:
    """Make the plan, write it to the folder `out` and print what came of it; exit where it is not
    good.

    The plan is safe before it is drawn; a colliding one is worth looking at.
    """
    console = console_of(stderr=as_json)
    missing = list[str]()
    with (
        claim_folder(out, (*_FILES, *(f"figures/{name}.png" for name in PLAN_NAMES))) as claim,
        drawer() as draw,
    ):
        with busy(console, "planning") as show:
            output = make(lambda text: show(plain_line(f"planning: {text}")))
        with claim.staged() as staging:
            files = output.write(staging)
        if output.record is not None:
            with claim.staged(keep=files) as staging:
                missing = draw(
                    drawings_of(output.record, output.robot, staging, (SCENE, *PLAN_NAMES))
                )
        written = claim.written()
    _print_plan(console, output, written)
    for line in missing:
        console.print(line, style="yellow", markup=False)
    if as_json:
        print_json(output.report)
    if output.stopped or not output.good:
        raise typer.Exit(INTERRUPTED if output.stopped else NOT_COMPLETED)


def _print_plan(console: Console, output: PlanOutput, paths: list[Path]) -> None:
    reason = f" ({output.report['reason']})" if "reason" in output.report else ""
    console.print(
        plain_line(f"plan: {output.report['status']}{reason}; advice: {output.report['advice']}")
    )
    output.show(console, output)
    print_paths(console, paths)


def _or_best(search: Callable[[], Any]) -> tuple[Any, bool]:
    """Return the result of a search, or its best so far where Ctrl-C ended it, and whether it
    did.
    """
    try:
        return search(), False
    except Interrupted as stop:
        return stop.result, True


def _print_motion(console: Console, output: PlanOutput) -> None:
    report = output.report
    if output.record is not None:
        clearance = report["min_clearance_m"]
        if clearance is None:
            clearance_text = ""
        else:
            clearance_text = (
                f", {clearance:.3g} m between {report['min_clearance_between']}"
                f" at {report['min_clearance_at_s']:.2f} s"
            )
        clearances = sorted((d, name) for name, d in (report["clearances_m"] or {}).items())
        if len(clearances) > 1:
            parts = ", ".join(f"{d:.3g} m to {name}" for d, name in clearances[:4])
            clearance_text += f" ({parts})"
        console.print(
            plain_line(
                f"{report['duration_s']:.1f} s long{clearance_text};"
                f" found in {report['solve_time_s']:.2f} s"
            )
        )
    unshaped = report["links_without_shape"]
    if unshaped:
        text = (
            f"{', '.join(unshaped)}: no collision shape in the robot's file, so that nothing is"
            " said of what they touch"
        )
        console.print(plain_line(text), style="yellow")
    surfaces = report.get("open_surfaces")
    if surfaces:
        text = f"{', '.join(surfaces)}: open mesh, of which nothing is said behind its surface"
        console.print(plain_line(text), style="yellow")
    if report.get("peak_thrust_n") is not None:
        if report["energy_j"] is None:
            energy = "- J (not known)"
        else:
            energy = f"{report['energy_j']:.0f} J"
        console.print(f"{energy}, thrust up to {report['peak_thrust_n']:.0f} N")


# ``plan mission``: all phases of a scenario as one problem, for ``run --follow``.


def mission(
    name: opt.Name,
    changes: opt.ScenarioOptions = opt.AS_IT_IS,
    noise: opt.Noise = None,
    within: Annotated[
        float | None,
        typer.Option(
            metavar="S", help="Longest duration [s]; default: that of the greedy mission."
        ),
    ] = None,
    step: Annotated[float, typer.Option(metavar="S", help="Step of the horizon [s].")] = 1.0,
    time_limit: Annotated[
        float, typer.Option(metavar="S", help="Time limit of each solve [s].")
    ] = _NLP["time_limit"],
    nlp: Annotated[str, typer.Option(help=f"Solver: {' or '.join(PLUGINS)}.")] = _NLP["plugin"],
    out: opt.Out = None,
    as_json: opt.Json = False,
) -> None:
    """A whole mission as one problem of least energy.

    Current, obstacles, floor and all limits included; `run SCENARIO --follow DIR/plan.npz` flies
    it, with the same options.
    """
    from uvms_ocp.mission_plan.planner import OPTIONS, plan_mission  # a tenth of a second

    options = changes.chosen | opt.given(noise=noise)
    scenario = opt.build_scenario(name, options)
    solver = replace(OPTIONS, plugin=nlp, time_limit=time_limit)
    target = out or opt.default_folder(("plan", "mission", opt.label(name)), options)

    def by_mission(_: Progress) -> PlanOutput:
        plan, stopped = _or_best(
            lambda: plan_mission(scenario, duration=within, step=step, options=solver)
        )

        def save(folder: Path) -> None:
            plan.save(folder / "plan.npz")

        return PlanOutput(
            robot=scenario.robot,
            report=plan.summary(),
            record=None,
            good=plan.solved,
            stopped=stopped,
            save=save if plan.status.usable else None,
            show=_print_mission,
        )

    make_and_write_plan(by_mission, target, as_json)


def _print_mission(console: Console, output: PlanOutput) -> None:
    report = output.report
    if output.save is not None:
        console.print(table_of(f"{report['scenario']} as one problem", report["phases"], _COLUMNS))
        if report["energy_j"] is None:
            energy = "- J (not known)"
        else:
            energy = f"{report['energy_j']:.0f} J"
        greedy = f"greedy {report['greedy_duration_s']:.1f} s"
        console.print(
            f"{report['duration_s']:.1f} s ({greedy}), {energy}, thrust up to"
            f" {report['peak_thrust_n']:.0f} N; {report['iterations']} iterations, found in"
            f" {report['solve_time_s']:.1f} s"
        )


# ``plan curve`` and ``plan ocp``: a motion among obstacles, by a smooth curve or by optimal
# control.

_MOTION = opt.defaults_of(MotionOptions)


def curve(
    motion: MotionOptions,
    files: opt.PlannedRobotFiles = _AS_WRITTEN,
    axes: _Axes = _CURVE["axes"],
    seed: Annotated[int, typer.Option(help="Seed of restarts and sampling.")] = _CURVE["seed"],
    out: opt.Out = None,
    as_json: opt.Json = False,
) -> None:
    """A smooth curve of the shapes alone, proven free of collision.

    From the stowed posture to a goal of the tool, of the vehicle or of joints, as fast as the
    limits of velocity and acceleration allow; without water and forces.
    """
    request = PlanRequest(**motion.asked(files), axes=axes, seed=seed)
    changed = _changed(_CURVE | _MOTION, robot=motion.robot, seed=seed)
    make_and_write_plan(
        lambda _: _by_curve(request), out or opt.default_folder(("plan", "curve"), changed), as_json
    )


def ocp(
    motion: MotionOptions,
    files: opt.PlannedRobotFiles = _AS_WRITTEN,
    duration: Annotated[float, typer.Option(metavar="S", help="Length [s].")] = _OCP["duration"],
    steps: Annotated[int, typer.Option(metavar="N", help="Steps of the horizon.")] = _OCP[
        "n_steps"
    ],
    current: Annotated[Triple, typer.Option(metavar="X Y Z", help="Current in W [m/s].")] = _OCP[
        "current"
    ],
    seabed: Annotated[
        float | None, typer.Option(metavar="Z", help="Height of a level floor [m].")
    ] = None,
    time_limit: Annotated[
        float, typer.Option(metavar="S", help="Time limit of the solver [s].")
    ] = _OCP["time_limit"],
    nlp: Annotated[str, typer.Option(help=f"Solver: {' or '.join(PLUGINS)}.")] = _OCP["plugin"],
    out: opt.Out = None,
    as_json: opt.Json = False,
) -> None:
    """Optimal control in water, within thrust and torque.

    From rest in the stowed posture to rest at a goal of the tool, of the vehicle or of joints, with
    little effort, and proven free of collision with obstacles, the floor and its own links.
    """
    request = OcpRequest(
        **motion.asked(files),
        duration=duration,
        n_steps=steps,
        current=current,
        seabed=_OCP["seabed"] if seabed is None else seabed,
        time_limit=time_limit,
        plugin=nlp,
    )
    changed = _changed(_OCP | _MOTION, robot=motion.robot, current=current)
    make_and_write_plan(
        lambda progress: _by_ocp(request, progress),
        out or opt.default_folder(("plan", "ocp"), changed),
        as_json,
    )


def _changed(defaults: Mapping[str, Any], **options: Any) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value != defaults[name]}


def _by_curve(request: PlanRequest) -> PlanOutput:
    result = plan_path(request)
    plan = result.plan

    def save(folder: Path) -> None:
        assert plan is not None
        plan.trajectory.to_numpy(folder / "plan.npz")
        plan.trajectory.to_csv(folder / "plan.csv", _PERIOD, names=result.scene.coordinates.names)

    return PlanOutput(
        robot=request.robot,
        report=plan_report(result),
        record=None if plan is None else motion_record(result, plan),
        good=plan is not None and plan.status is PlanStatus.FREE,
        save=None if plan is None else save,
        show=_print_motion,
    )


def _by_ocp(request: OcpRequest, progress: Progress) -> PlanOutput:
    result, stopped = _or_best(
        lambda: solve_ocp(request, progress=lambda moment: progress(_words(moment)))
    )

    def save(folder: Path) -> None:
        for name in ("plan.npz", "plan.json"):
            result.plan.save(folder / name)

    # What breaks a constraint is drawn and saved too: that is how one sees where.
    has_motion = result.plan.status.usable or result.plan.status is OcpStatus.BROKEN
    return PlanOutput(
        robot=request.robot,
        report=ocp_report(result),
        record=ocp_record(result) if has_motion else None,
        good=result.plan.status is OcpStatus.SOLVED and result.collision_free,
        stopped=stopped,
        save=save if has_motion or stopped else None,
        show=_print_motion,
    )


def _words(moment: IterationReport) -> str:
    """Describe an iteration in a line; Ctrl-C keeps the best plan so far."""
    progress = (
        f"iteration {moment.iteration}, residual {moment.residual:.3g}, constraints broken by"
        f" {moment.violation:.1e}"
    )
    return f"level {moment.level!r}, {progress} (Ctrl-C stops)"
