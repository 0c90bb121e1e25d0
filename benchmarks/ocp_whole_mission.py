"""All phases of Case 1 as one problem, against the greedy mission: ``python benchmarks/ocp_whole_mission.py``.

Both are carried out on the physical plant, and judged there. Writes ocp_whole_mission.csv and ocp_whole_mission.md.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from horizon.carried_out import FORMATS, Place, carried_out, ends_of_phases, greedy
from recording.processes import hide_compiler
from recording.report import Report, Table, begin, parser_of
from recording.timing import Timed, built, once

from uvms_ocp.model.state import State
from uvms_ocp.ocp.plan import Plan
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.whole_mission import WholeMission, whole_mission
from uvms_ocp.scenario import Scenario, pose_at
from uvms_ocp.scenarios.case1 import Thresholds, case1
from uvms_ocp.solvers.nlp.lexicographic_nlp import NlpOptions

TARGET = np.array([12.2025, 37.3748, -39.886])
PLACE = Place(way_point=pose_at((10.8, 37.45, -38.0), (0.0, -0.06, 0.5)), target=TARGET, floor=-40.0)
ASKED, ASKED_TILT = Thresholds.suggested(plant="dynamic", noise=False), 0.1  # [rad]
# Stricter than the mission asks: carried out, the plan is followed with an error.
MISSION = WholeMission(
    way_point=PLACE.way_point,
    target=TARGET,
    tool_goal=pose_at(tuple(TARGET), (np.pi, 0.0, 0.0)),
    durations=((5.0, 20.0), (2.0, 6.0), (4.0, 14.0), (4.0, 14.0)),
    tilt=0.09,
    misalignment=0.065,
)
OPTIONS = NlpOptions(max_iterations=600, convergence=1e-5, time_limit=300.0)
PROSE = """
Greedy: the mission as `uvms-ocp run case1` flies it, phase after phase, by the velocity hierarchy above the dynamic
layer; its time includes what its transitions make it hold still. One problem: way point, alignment, landing and tool as
the first level of one optimal control problem with free durations, energy below it. Both are to end with the tool where
it should be and to keep the tilt below {tilt:g} rad, and are carried out, with feedback, on the physical plant; the
figures are of that.

Plan: {status} in {iterations} iterations, {cpu:.0f} s of processor time; {build:.1f} s before that for transcription,
code and its compilation from an empty cache.

{thresholds}
"""


def planned(
    scenario: Scenario, mission: WholeMission, options: NlpOptions, *, cold: bool
) -> tuple[Timed[Planner], Timed[Plan]]:
    """The planner and its plan; cold: built from an empty cache of compiled code."""
    start = State(q=np.array(scenario.start), v=np.zeros(scenario.robot.n_v))
    problem = whole_mission(scenario.robot, start, mission, floor=PLACE.floor)
    made = built(lambda: Planner(problem, options), cold=cold)
    return made, once(made.value.plan)


def ticks_at_ends(planner: Planner, plan: Plan, way: np.ndarray, dt: float) -> list[int]:
    """Ticks of dt [s] along a way of q (n, n_q) at which A, B and C end."""
    nodes = list(planner.problem.starts_of_phases())[1:4]
    return [min(round(float(plan.trajectory.t[node]) / dt), len(way)) for node in nodes]


def main() -> None:
    """Plan, carry out, compare."""
    _, run = begin(parser_of(__doc__))
    mission, options, scenario = MISSION, OPTIONS, case1()
    if run.quick:
        hide_compiler()
        mission = replace(MISSION, n_steps=(1, 1, 1, 1), durations=((0.1, 0.2),) * 4)
        options, scenario = replace(OPTIONS, max_iterations=1), replace(scenario, duration=0.2)
    made, found = planned(scenario, mission, options, cold=not run.quick)
    plan = found.value
    row, way = carried_out(scenario, plan, PLACE)
    ends = ticks_at_ends(made.value, plan, way, scenario.dt)
    prose = PROSE.format(
        tilt=ASKED_TILT,
        status=plan.status.value,
        iterations=plan.iterations,
        cpu=found.cpu,
        build=made.wall,
        thresholds=ends_of_phases(scenario.robot, way, ends, PLACE, ASKED, mission.minimum_altitude),
    )
    table = Table(rows=[greedy(scenario, PLACE), row], columns=FORMATS)
    run.write(Report(name="ocp_whole_mission", title="Case 1 as one problem", prose=prose, tables=[table]))


if __name__ == "__main__":
    main()
