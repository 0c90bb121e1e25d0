"""``plan``: a motion among obstacles, by a smooth curve or by optimal control."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from uvms_ocp.cli.options import NOT_COMPLETED, Json, folder, given
from uvms_ocp.cli.printing import print_json, print_paths
from uvms_ocp.collision.obstacle_file import ObstacleData, obstacle_from_words, read_obstacles
from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.model.loading import load_robot
from uvms_ocp.model.robot import Robot
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.request import OcpRequest, solve_ocp
from uvms_ocp.output import staged_folder
from uvms_ocp.planning.goals import PostureGoal, ToolGoal
from uvms_ocp.planning.request import AXES, PlanRequest, solve
from uvms_ocp.record import Record
from uvms_ocp.report.ocp_motion import ocp_record, ocp_report
from uvms_ocp.report.planned_motion import motion_record, plan_report
from uvms_ocp.solvers.nlp.nlp_options import PLUGINS

_PLAN_PERIOD = 0.02  # [s] between rows of plan.csv
_Triple = tuple[float, float, float]
CURVE, OCP = METHODS = ("curve", "ocp")
_FIGURES = ("vehicle_motion", "joint_motion", "clearance", "efforts")
_FILES = (  # of any plan; which of them there are depends on the method and on what came of it
    *("report.json", "plan.npz", "plan.csv", "plan.json", "record.npz", "scene.html"),
    *(f"figures/{name}.png" for name in _FIGURES),
)


def plan(
    tool: Annotated[_Triple | None, typer.Option(metavar="X Y Z", help="Goal of the tool in W [m].")] = None,
    tool_rpy: Annotated[_Triple | None, typer.Option(metavar="R P Y", help="Its orientation; default: any.")] = None,
    joint: Annotated[list[str] | None, typer.Option(metavar="NAME=Q", help="Goal of a joint; repeatable.")] = None,
    to: Annotated[_Triple | None, typer.Option(metavar="X Y Z", help="Goal of the vehicle [m].")] = None,
    to_rpy: Annotated[_Triple | None, typer.Option(metavar="R P Y", help="Goal of its attitude [rad].")] = None,
    position: Annotated[_Triple | None, typer.Option(metavar="X Y Z", help="Start of the vehicle [m].")] = None,
    rpy: Annotated[_Triple | None, typer.Option(metavar="R P Y", help="Attitude at the start [rad].")] = None,
    sphere: Annotated[list[str] | None, typer.Option(metavar="X,Y,Z,R", help="Obstacle; repeatable.")] = None,
    box: Annotated[list[str] | None, typer.Option(metavar="X,Y,Z,LX,LY,LZ", help="Obstacle; repeatable.")] = None,
    obstacles: Annotated[Path | None, typer.Option(metavar="YAML", help="File of obstacles.")] = None,
    robot: Annotated[str, typer.Option(help="Robot, see `uvms-ocp list`.")] = "girona_maris7_full",
    clearance: Annotated[float, typer.Option(metavar="M", help="Distance wanted from everything [m].")] = 0.06,
    method: Annotated[
        str,
        typer.Option(help="curve: smooth, of the shapes alone; ocp: optimal control with water, thrust and torque."),
    ] = CURVE,
    axes: Annotated[
        str | None,
        typer.Option(help=f"curve: planned axes, of {', '.join(AXES)}; level, the default: no roll, no pitch."),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="curve: seed of restarts and sampling; default: 0.")] = None,
    duration: Annotated[float | None, typer.Option(metavar="S", help="ocp: length [s]; default: 8.")] = None,
    steps: Annotated[int | None, typer.Option(metavar="N", help="ocp: steps of the horizon; default: 40.")] = None,
    current: Annotated[
        _Triple | None, typer.Option(metavar="X Y Z", help="ocp: current in W [m/s]; default: none.")
    ] = None,
    time_limit: Annotated[
        float | None, typer.Option(metavar="S", help="ocp: time limit of the solver [s]; default: 20.")
    ] = None,
    nlp: Annotated[str | None, typer.Option(help=f"ocp: {' or '.join(PLUGINS)}; default: {PLUGINS[0]}.")] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", parser=folder, help="Folder for the results.")] = Path(
        "uvms_runs/plan"
    ),
    as_json: Json = False,
) -> None:
    """Plan a motion among obstacles to a goal of the tool, the vehicle or joints, from the stowed posture."""
    console, model = Console(stderr=as_json), load_robot(robot)
    _check_vehicle(model, {"to": to, "to-rpy": to_rpy, "position": position, "rpy": rpy})
    asked: dict[str, Any] = {
        "robot": model,
        "start": model.configuration(position=position, rpy=rpy),
        "goal": _plan_goal(tool, tool_rpy, PostureGoal(position=to, rpy=to_rpy, joints=_joint_goals(joint or []))),
        "obstacles": _plan_obstacles(sphere or [], box or [], obstacles),
        "clearance": clearance,
    }
    curve = {"axes": axes, "seed": seed}
    ocp = {"duration": duration, "steps": steps, "current": current, "time-limit": time_limit, "nlp": nlp}
    chosen = asked | _chosen(method, {CURVE: curve, OCP: ocp})
    with staged_folder(out, earlier=_FILES) as staging:
        with console.status("planning"):
            made = _by_curve(PlanRequest(**chosen)) if method == CURVE else _by_ocp(OcpRequest(**chosen))
        made.write(staging)
        written = sorted(path.relative_to(staging) for path in staging.rglob("*") if path.is_file())
    _print_plan(console, made.report, [out / path for path in written])
    if as_json:
        print_json(made.report)
    if not made.good:
        raise typer.Exit(NOT_COMPLETED)


@dataclass(frozen=True, kw_only=True)
class _Made:
    """A plan of either method: its report, its motion if there is one, and how to write what only this method has."""

    report: dict[str, Any]
    record: Record | None
    robot: Robot
    good: bool
    save: Callable[[Path], object]

    def write(self, folder: Path) -> None:
        """The report always, the rest where there is a motion; a colliding one is worth looking at."""
        from uvms_ocp.viz.plan_figures import write_plan_figures
        from uvms_ocp.viz.scene import write_scene

        (folder / "report.json").write_text(json.dumps(self.report, indent=2) + "\n")
        if self.record is None:
            return
        self.save(folder)
        self.record.save(folder / "record.npz")
        write_plan_figures(self.record, folder / "figures")
        write_scene(self.record, self.robot, folder / "scene.html")


def _by_curve(request: PlanRequest) -> _Made:
    result = solve(request)
    plan = result.plan

    def save(folder: Path) -> None:
        assert plan is not None
        plan.trajectory.to_numpy(folder / "plan.npz")
        plan.trajectory.to_csv(folder / "plan.csv", _PLAN_PERIOD, names=result.scene.coordinates.names)

    return _Made(
        report=plan_report(result),
        record=None if plan is None else motion_record(result, plan),
        robot=request.robot,
        good=result.collision_free,
        save=save,
    )


def _by_ocp(request: OcpRequest) -> _Made:
    result = solve_ocp(request)

    def save(folder: Path) -> None:
        for name in ("plan.npz", "plan.json"):
            result.plan.save(folder / name)

    return _Made(
        report=ocp_report(result),
        record=ocp_record(result) if result.plan.status.usable else None,
        robot=request.robot,
        good=result.plan.status is OcpStatus.SOLVED and result.collision_free,
        save=save,
    )


_FIELDS = {
    "steps": "n_steps",
    "nlp": "plugin",
    "time-limit": "time_limit",
}  # of the request, where options are called otherwise


def _chosen(method: str, options: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Fields of the request for the options of a method that were given; those of another method are refused."""
    if method not in METHODS:
        raise NameNotFound("method", method, METHODS)
    for other, values in options.items():
        for name in given(**values):
            if other != method:
                raise InvalidInput(f"--{name} is for --method {other}, not for {method}; leave it out")
    return {_FIELDS.get(name, name): value for name, value in given(**options[method]).items()}


def _check_vehicle(robot: Robot, poses: dict[str, _Triple | None]) -> None:
    """Raise `InvalidInput` for an option of the vehicle where the robot has none."""
    for name in given(**poses):
        if not robot.n_vehicle:
            raise InvalidInput(
                f"--{name}: {robot.name} has no free vehicle pose; give --joint NAME=Q with any of "
                f"{', '.join(robot.joint_names)}, or --tool"
            )


def _joint_goals(words: list[str]) -> dict[str, float]:
    goals = {}
    for word in words:
        name, _, value = word.partition("=")
        try:
            goals[name] = float(value)
        except ValueError:
            raise InvalidInput(f"--joint {word}: give NAME=VALUE, such as joint2=0.5") from None
    return goals


def _plan_goal(tool: _Triple | None, tool_rpy: _Triple | None, posture: PostureGoal) -> ToolGoal | PostureGoal:
    """The one goal that was given."""
    has_posture = bool(posture.joints or posture.position or posture.rpy)
    if (tool is None) != has_posture or (tool is None and tool_rpy is not None):
        raise InvalidInput("give one goal: --tool, with or without --tool-rpy, or any of --to, --to-rpy and --joint")
    return posture if tool is None else ToolGoal(position=tool, rpy=tool_rpy)


def _plan_obstacles(spheres: list[str], boxes: list[str], path: Path | None) -> tuple[ObstacleData, ...]:
    return (
        *(read_obstacles(path) if path else ()),
        *(obstacle_from_words("sphere", words, f"sphere{i}") for i, words in enumerate(spheres, 1)),
        *(obstacle_from_words("box", words, f"box{i}") for i, words in enumerate(boxes, 1)),
    )


def _print_plan(console: Console, report: dict[str, Any], paths: list[Path]) -> None:
    status = report["status"] + (f" ({report['reason']})" if "reason" in report else "")
    console.print(f"plan: {status}; advice: {report['advice']}", markup=False)
    if "duration_s" in report:
        least = report["min_clearance_m"]
        near = "" if least is None else f", {least:.3g} m between {report['min_clearance_between']} "
        near += "" if least is None else f"at {report['min_clearance_at_s']:.2f} s"
        console.print(f"{report['duration_s']:.1f} s long{near}; found in {report['solve_time_s']:.2f} s", markup=False)
    if report.get("energy_j") is not None:
        console.print(f"{report['energy_j']:.0f} J, thrust up to {report['peak_thrust_n']:.0f} N", markup=False)
    print_paths(console, paths)
