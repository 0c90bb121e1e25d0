"""Times of a reach by optimal control, cold and warm: ``python benchmarks/ocp_reach.py``.

Writes ocp_reach.csv and ocp_reach.md, one row per size, solver, Hessian and start, failures
included.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from horizon.problems import REACH, tool_reach
from horizon.reach import SHIFT, TURN, exact_rows, gauss_newton_rows, rows as rows_of
from horizon.tracking import tracked
from recording.processes import hide_compiler, run_script
from recording.report import Report, Row, Table, begin, parser_of

from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import HessianKind, OcpProblem
from uvms_ocp.scenario.plan_replay import TrackingError, tracking_error
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.solvers.nlp.options import NlpOptions

REPEATS = 3
STEPS = (20, 40, 80)
OPTIONS = NlpOptions(max_iterations=3)
"""Options of a quick run."""
PROSE = """
{dofs} degrees of freedom in water, {thrusters} thrusters and {joints} joints within their limits:
in {duration:g} s the tool moves {way:.2f} m, turns, and comes to rest; below that, least effort and
acceleration. Two levels, anticipated: one NLP where the goal can be met. *build_s*: transcription,
code and its compilation from an empty cache, once. Cold: from rest at the start; warm: again from
the solution; moved: from the solution too, but the start is {shift:g} m and {turn:g} rad away from
where it was. Times are of whole calls of `Planner.plan`, the least of {repeats} after one to warm
up; `goal` is the residual of the first level, `cost` that of the second.

Carried out on the physical plant, N = {steps}: tool off by {end_mm:.2f} mm and {end_mrad:.2f} mrad
at the end, {most_mm:.2f} mm at most on the way.
"""
FORMATS = {
    "steps": "",
    "solver": "",
    "setting": "",
    "start": "",
    "status": "",
    "iterations": "",
    "build_s": ".2f",
    "cpu_ms": ".1f",
    "wall_ms": ".1f",
    "goal": ".1e",
    "cost": ".9f",
}


def all_rows(steps: tuple[int, ...], repeats: int) -> list[Row]:
    """Every size with both solvers and both Hessians; the middle size without a compiler as
    well.
    """
    rows = list[Row]()
    for n in steps:
        rows += exact_rows(n, repeats, cold=True)
    for n in steps:
        rows += gauss_newton_rows(n, repeats)
    rows += interpreted_rows(steps[1], repeats)
    return rows


def interpreted_rows(n_steps: int, repeats: int) -> list[Row]:
    """Measure in another process that finds no compiler."""
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "rows.json"
        script = Path(__file__).parent / "horizon" / "reach.py"
        run_script(sys.executable, script, n_steps, result, "--repeats", repeats, compiler=False)
        rows = json.loads(result.read_text())
    return [row | {"setting": f"{row['setting']}, virtual machine"} for row in rows]


def carried_out(problem: OcpProblem, options: NlpOptions) -> TrackingError:
    """A plan on the physical plant, followed with feedback."""
    plan = Planner(problem, options).plan(diagnose=False)
    environment = Environment(seafloor=FlatSeafloor(z=-40))
    series = tracked(
        problem.robot, plan.trajectory, environment, dt=1 / 200, duration=plan.duration
    )
    return tracking_error(
        plan.trajectory, series["t"], series["q"], robot=problem.robot, frame="tool"
    )


def prose(problem: OcpProblem, repeats: int, off: TrackingError) -> str:
    """Fill in the figures of the problem and of the plan that was carried out."""
    return PROSE.format(
        dofs=problem.robot.n_v,
        thrusters=len(problem.robot.description.thrusters),
        joints=problem.robot.n_joints,
        duration=problem.nominal_times()[-1],
        way=float(np.linalg.norm(REACH)),
        shift=SHIFT,
        turn=TURN,
        repeats=repeats,
        steps=problem.n_steps,
        end_mm=1e3 * off.end_position,
        end_mrad=1e3 * off.end_orientation,
        most_mm=1e3 * off.position,
    )


def main() -> None:
    """Solve and carry out."""
    _, run = begin(parser_of(__doc__))
    if run.quick:
        hide_compiler()
        repeats = 1
        problem = tool_reach(3, hessian=HessianKind.GAUSS_NEWTON, duration=0.5)
        rows: list[Row] = [*rows_of("quick", problem, OPTIONS, repeats, False)]
    else:
        repeats = REPEATS
        problem = tool_reach(STEPS[1])
        rows = all_rows(STEPS, repeats)
    table = Table(rows=rows, columns=FORMATS)
    text = prose(problem, repeats, carried_out(problem, OPTIONS if run.quick else NlpOptions()))
    run.write(
        Report(
            name="ocp_reach", title="Optimal control: the tool reach", prose=text, tables=[table]
        )
    )


if __name__ == "__main__":
    main()
