"""``plan curve`` and ``plan ocp``: a motion among obstacles, by a smooth curve or by optimal control."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from uvms_ocp.cli.option_group import defaults_of, spread_options
from uvms_ocp.cli.options import Json, Out, default_folder
from uvms_ocp.cli.plans.plan_mission import mission
from uvms_ocp.cli.plans.plan_options import MotionOptions
from uvms_ocp.cli.plans.plan_output import MadePlan, Tell, put_out
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.request import OcpRequest, solve_ocp
from uvms_ocp.planning.goals import Triple
from uvms_ocp.planning.request import AXES, PlanRequest, solve
from uvms_ocp.report.ocp_motion import ocp_record, ocp_report
from uvms_ocp.report.planned_motion import motion_record, plan_report
from uvms_ocp.solvers.nlp.nlp_options import PLUGINS
from uvms_ocp.solvers.nlp.watch import Moment

_PERIOD = 0.02  # [s] between rows of plan.csv
_CURVE, _OCP = defaults_of(PlanRequest), defaults_of(OcpRequest)
_MOTION = defaults_of(MotionOptions)
_Axes = Annotated[str, typer.Option(help=f"Planned axes, of {', '.join(AXES)}; level: no roll, no pitch.")]


def curve(
    motion: MotionOptions,
    axes: _Axes = _CURVE["axes"],
    seed: Annotated[int, typer.Option(help="Seed of restarts and sampling.")] = _CURVE["seed"],
    out: Out = None,
    as_json: Json = False,
) -> None:
    """A smooth curve of the shapes alone, proven free of collision.

    From the stowed posture to a goal of the tool, of the vehicle or of joints, as fast as the limits of velocity and
    acceleration allow; without water and forces.
    """
    request = PlanRequest(**motion.asked(), axes=axes, seed=seed)
    changed = _changed(_CURVE | _MOTION, robot=motion.robot, seed=seed)
    put_out(lambda _: _by_curve(request), out or default_folder(("plan", "curve"), changed), as_json)


def ocp(
    motion: MotionOptions,
    duration: Annotated[float, typer.Option(metavar="S", help="Length [s].")] = _OCP["duration"],
    steps: Annotated[int, typer.Option(metavar="N", help="Steps of the horizon.")] = _OCP["n_steps"],
    current: Annotated[Triple, typer.Option(metavar="X Y Z", help="Current in W [m/s].")] = _OCP["current"],
    seabed: Annotated[float | None, typer.Option(metavar="Z", help="Height of a level floor [m].")] = None,
    time_limit: Annotated[float, typer.Option(metavar="S", help="Time limit of the solver [s].")] = _OCP["time_limit"],
    nlp: Annotated[str, typer.Option(help=f"Solver: {' or '.join(PLUGINS)}.")] = _OCP["plugin"],
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Optimal control in water, within thrust and torque.

    From rest in the stowed posture to rest at a goal of the tool, of the vehicle or of joints, with little effort, and
    proven free of collision with obstacles, the floor and its own links.
    """
    request = OcpRequest(
        **motion.asked(),
        duration=duration,
        n_steps=steps,
        current=current,
        seabed=_OCP["seabed"] if seabed is None else seabed,
        time_limit=time_limit,
        plugin=nlp,
    )
    changed = _changed(_OCP | _MOTION, robot=motion.robot, current=current)
    put_out(lambda tell: _by_ocp(request, tell), out or default_folder(("plan", "ocp"), changed), as_json)


app = typer.Typer(help="Plan a motion among obstacles, or a whole mission.", no_args_is_help=True)
app.command(name="curve")(spread_options(curve))
app.command(name="ocp")(spread_options(ocp))
app.command(name="mission")(mission)


def _changed(defaults: Mapping[str, Any], **options: Any) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value != defaults[name]}


def _by_curve(request: PlanRequest) -> MadePlan:
    result = solve(request)
    plan = result.plan

    def save(folder: Path) -> None:
        assert plan is not None
        plan.trajectory.to_numpy(folder / "plan.npz")
        plan.trajectory.to_csv(folder / "plan.csv", _PERIOD, names=result.scene.coordinates.names)

    return MadePlan(
        robot=request.robot,
        report=plan_report(result),
        record=None if plan is None else motion_record(result, plan),
        good=result.collision_free,
        save=save,
    )


def _by_ocp(request: OcpRequest, tell: Tell) -> MadePlan:
    result = solve_ocp(request, progress=lambda moment: tell(_words(moment)))

    def save(folder: Path) -> None:
        for name in ("plan.npz", "plan.json"):
            result.plan.save(folder / name)

    return MadePlan(
        robot=request.robot,
        report=ocp_report(result),
        record=ocp_record(result) if result.plan.status.usable else None,
        good=result.plan.status is OcpStatus.SOLVED and result.collision_free,
        save=save,
    )


def _words(moment: Moment) -> str:
    """Ctrl-C keeps the best plan so far."""
    found = (
        f"iteration {moment.iteration}, residual {moment.residual:.3g}, constraints broken by {moment.violation:.1e}"
    )
    return f"level {moment.level!r}, {found} (Ctrl-C stops)"
