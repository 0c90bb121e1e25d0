"""``plan curve``, ``plan ocp`` and ``plan mission``: plan a motion among obstacles, by a smooth curve
or by optimal control, or a whole mission.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from uvms_ocp.cli import options as opt
from uvms_ocp.cli.motion_options import MotionOptions
from uvms_ocp.cli.option_groups import defaults_of
from uvms_ocp.cli.plan_output import PlanOutput, Progress, best_so_far, make_and_write_plan
from uvms_ocp.cli.printing import table_of
from uvms_ocp.cli.result_folders import default_folder, label
from uvms_ocp.errors import plain_line
from uvms_ocp.ocp import OcpRequest, OcpStatus, solve_ocp
from uvms_ocp.planning.request import AXES, PlanRequest, Triple, plan_path
from uvms_ocp.planning.soft_collision import PlanStatus
from uvms_ocp.report.planned_motion import motion_record, ocp_record, ocp_report, plan_report
from uvms_ocp.solvers.nlp.options import PLUGINS, NlpOptions
from uvms_ocp.solvers.nlp.solve_monitor import IterationReport

_PERIOD = 0.02  # [s] between rows of plan.csv

_CURVE = defaults_of(PlanRequest)
_OCP = defaults_of(OcpRequest)
_NLP = defaults_of(NlpOptions)
_MOTION = defaults_of(MotionOptions)
_AS_WRITTEN = opt.PlannedRobotFiles()

_Axes = Annotated[
    str, typer.Option(help=f"Planned axes, of {', '.join(AXES)}; level: no roll, no pitch.")
]


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
    request = PlanRequest(**motion.request_fields(files), axes=axes, seed=seed)
    changed = _changed(_CURVE | _MOTION, robot=motion.robot, seed=seed)
    folder = out or default_folder(("plan", "curve"), changed)
    make_and_write_plan(lambda _: _by_curve(request), folder, as_json)


def _by_curve(request: PlanRequest) -> PlanOutput:
    result = plan_path(request)
    plan = result.plan
    if plan is None:
        return PlanOutput(
            robot=request.robot,
            report=plan_report(result),
            record=None,
            good=False,
            save=None,
            show=_print_motion,
        )

    def save(folder: Path) -> None:
        names = result.scene.coordinates.names
        plan.trajectory.to_numpy(folder / "plan.npz")
        plan.trajectory.to_csv(folder / "plan.csv", _PERIOD, names=names)

    return PlanOutput(
        robot=request.robot,
        report=plan_report(result),
        record=motion_record(result, plan),
        good=plan.status is PlanStatus.FREE,
        save=save,
        show=_print_motion,
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
        **motion.request_fields(files),
        duration=duration,
        n_steps=steps,
        current=current,
        seabed=_OCP["seabed"] if seabed is None else seabed,
        time_limit=time_limit,
        plugin=nlp,
    )
    changed = _changed(_OCP | _MOTION, robot=motion.robot, current=current)
    folder = out or default_folder(("plan", "ocp"), changed)
    make_and_write_plan(lambda progress: _by_ocp(request, progress), folder, as_json)


def _by_ocp(request: OcpRequest, progress: Progress) -> PlanOutput:
    def show_iteration(iteration: IterationReport) -> None:
        progress(_describe_iteration(iteration))

    result, stopped = best_so_far(lambda: solve_ocp(request, progress=show_iteration))
    plan = result.plan

    def save(folder: Path) -> None:
        plan.save(folder / "plan.npz")
        plan.save(folder / "plan.json")

    # What breaks a constraint is drawn and saved too: that is how one sees where.
    has_motion = plan.status.usable or plan.status is OcpStatus.BROKEN
    return PlanOutput(
        robot=request.robot,
        report=ocp_report(result),
        record=ocp_record(result) if has_motion else None,
        good=plan.status is OcpStatus.SOLVED and result.collision_free,
        stopped=stopped,
        save=save if has_motion or stopped else None,
        show=_print_motion,
    )


def _describe_iteration(iteration: IterationReport) -> str:
    """Describe an iteration in a line; Ctrl-C keeps the best plan so far."""
    return f"{iteration} (Ctrl-C stops)"


def _changed(defaults: Mapping[str, Any], **options: Any) -> dict[str, Any]:
    """Return the options that are not as by default, for the name of the folder."""
    return {name: value for name, value in options.items() if value != defaults[name]}


def _print_motion(console: Console, output: PlanOutput) -> None:
    """Print how long the motion is, what it comes near to, and what it takes."""
    report = output.report
    if output.record is not None:
        console.print(
            plain_line(
                f"{report['duration_s']:.1f} s long{_clearance_text(report)};"
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
        energy = _energy_text(report)
        console.print(f"{energy}, thrust up to {report['peak_thrust_n']:.0f} N")


def _clearance_text(report: Mapping[str, Any]) -> str:
    """Describe the least clearance of a motion, and the least to each of up to four obstacles."""
    if report["min_clearance_m"] is None:
        text = ""
    else:
        text = (
            f", {report['min_clearance_m']:.3g} m between {report['min_clearance_between']}"
            f" at {report['min_clearance_at_s']:.2f} s"
        )
    clearances = sorted((d, name) for name, d in (report["clearances_m"] or {}).items())
    if len(clearances) > 1:
        nearest = ", ".join(f"{d:.3g} m to {name}" for d, name in clearances[:4])
        text += f" ({nearest})"
    return text


def _energy_text(report: Mapping[str, Any]) -> str:
    if report["energy_j"] is None:
        return "- J (not known)"
    return f"{report['energy_j']:.0f} J"


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

    options = changes.chosen | opt.given_options(noise=noise)
    scenario = opt.build_scenario(name, options)
    solver = replace(OPTIONS, plugin=nlp, time_limit=time_limit)
    folder = out or default_folder(("plan", "mission", label(name)), options)

    def by_mission(_: Progress) -> PlanOutput:
        plan, stopped = best_so_far(
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

    make_and_write_plan(by_mission, folder, as_json)


def _print_mission(console: Console, output: PlanOutput) -> None:
    if output.save is None:
        return
    report = output.report
    columns = ("name", "begin_s", "end_s")
    console.print(table_of(f"{report['scenario']} as one problem", report["phases"], columns))
    durations = f"{report['duration_s']:.1f} s (greedy {report['greedy_duration_s']:.1f} s)"
    effort = f"{_energy_text(report)}, thrust up to {report['peak_thrust_n']:.0f} N"
    search = f"{report['iterations']} iterations, found in {report['solve_time_s']:.1f} s"
    console.print(f"{durations}, {effort}; {search}")
