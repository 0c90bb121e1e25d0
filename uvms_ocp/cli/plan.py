"""``plan``: a motion among obstacles."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from uvms_ocp.cli.options import NOT_COMPLETED, Json, folder
from uvms_ocp.cli.printing import print_json, print_paths
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.robot import load_robot
from uvms_ocp.output import staged_folder
from uvms_ocp.planning import (
    AXES,
    ObstacleData,
    PlanRequest,
    PlanResult,
    PostureGoal,
    ToolGoal,
    motion_record,
    obstacle_from_words,
    plan_report,
    read_obstacles,
    solve,
)

_PLAN_PERIOD = 0.02  # [s] between rows of plan.csv
_Triple = tuple[float, float, float]


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
    axes: Annotated[str, typer.Option(help=f"Planned axes: {', '.join(AXES)}; level: no roll, no pitch.")] = AXES[0],
    clearance: Annotated[float, typer.Option(metavar="M", help="Distance wanted from everything [m].")] = 0.06,
    seed: Annotated[int, typer.Option(help="Seed of restarts and sampling.")] = 0,
    out: Annotated[Path, typer.Option(metavar="DIR", parser=folder, help="Folder for the results.")] = Path(
        "uvms_runs/plan"
    ),
    as_json: Json = False,
) -> None:
    """Plan a motion among obstacles to a goal of the tool, the vehicle or joints, from the stowed posture."""
    console, model = Console(stderr=as_json), load_robot(robot)
    request = PlanRequest(
        robot=model,
        start=model.configuration(position=position, rpy=rpy),
        goal=_plan_goal(tool, tool_rpy, PostureGoal(position=to, rpy=to_rpy, joints=_joint_goals(joint or []))),
        obstacles=_plan_obstacles(sphere or [], box or [], obstacles),
        axes=axes,
        clearance=clearance,
        seed=seed,
    )
    with staged_folder(out) as staging:
        with console.status("planning"):
            result = solve(request)
        report = plan_report(result)
        _write_plan(result, report, staging)
        written = sorted(path.relative_to(staging) for path in staging.rglob("*") if path.is_file())
    _print_plan(console, report, [out / path for path in written])
    if as_json:
        print_json(report)
    if not result.collision_free:
        raise typer.Exit(NOT_COMPLETED)


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


def _write_plan(result: PlanResult, report: dict[str, Any], folder: Path) -> None:
    """The report always, the rest where there is a motion; a colliding one is worth looking at."""
    from uvms_ocp.viz import write_plan_figures, write_scene

    (folder / "report.json").write_text(json.dumps(report, indent=2) + "\n")
    if result.plan is None:
        return
    record = motion_record(result, result.plan)
    result.plan.trajectory.to_numpy(folder / "plan.npz")
    result.plan.trajectory.to_csv(folder / "plan.csv", _PLAN_PERIOD, names=result.scene.coordinates.names)
    record.save(folder / "record.npz")
    write_plan_figures(record, folder / "figures")
    write_scene(record, result.request.robot, folder / "scene.html")


def _print_plan(console: Console, report: dict[str, Any], paths: list[Path]) -> None:
    console.print(f"plan: {report['status']}; advice: {report['advice']}", markup=False)
    if "duration_s" in report:
        least = report["min_clearance_m"]
        near = "" if least is None else f", {least:.3g} m between {report['min_clearance_between']} "
        near += "" if least is None else f"at {report['min_clearance_at_s']:.2f} s"
        console.print(f"{report['duration_s']:.1f} s long{near}; found in {report['solve_time_s']:.2f} s", markup=False)
    print_paths(console, paths)
