"""Optimal control among obstacles: ``python benchmarks/ocp_scenes.py [--scenes N]``.

The scenes of `trajectories.py`, with water, thrusters and torques, for the robot whose thrusters
move all axes of the vehicle. Writes ocp_scenes.csv, one row per scene, and ocp_scenes.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from curves.controlled import Outcome, Scenes, collides
from curves.scenes import N_SCENES, problem
from recording.report import Report, Row, Table, begin, parser_of
from recording.rows import column

from uvms_ocp.robot.loading import load_robot

ROBOT = "girona_maris7_full"
PROSE = """
{scenes} scenes: {solved} are solved and certified free of collision, {false} of them falsely by
{samples} samples of coal. The guess is the curve of `plan_soft_collision`, at {slower:g} times its
duration, which thrust does not know; the clearance that is asked for is {clearance:g} m, or what
start or goal have. The median of the processor time is {median:.2f} s for all of it, curve and
proof included, the largest {largest:.2f} s; one planner is kept for all scenes, and building it
took {building:.1f} s. Not solved or not certified: {rest}.
"""


def row_of(outcome: Outcome) -> Row:
    """Make the row of one scene."""
    plan = outcome.plan
    return {
        "seed": outcome.seed,
        "status": plan.status.value,
        "certified": plan.certified_free,
        "falsely": plan.certified_free and collides(outcome),
        "nearest [mm]": round(1e3 * outcome.nearest, 2),
        "nearest pair": plan.clearance.nearest.pair if plan.clearance else "",
        "duration [s]": round(plan.duration, 2),
        "curve, processor [s]": round(outcome.curve_time, 3),
        "plan, processor [s]": round(outcome.plan_time, 3),
    }


def prose(rows: Sequence[Row], scenes: Scenes) -> str:
    """Fill in the figures of all scenes."""
    times = []
    failures = []
    for row in rows:
        times.append(row["curve, processor [s]"] + row["plan, processor [s]"])
        if row["status"] != "solved" or not row["certified"]:
            failures.append(f"seed {row['seed']} ({row['status']})")
    return PROSE.format(
        scenes=len(rows),
        solved=len(rows) - len(failures),
        false=sum(column(rows, "falsely")),
        samples=scenes.samples,
        slower=scenes.slower,
        clearance=scenes.clearance,
        median=float(np.median(times)),
        largest=max(times),
        building=scenes.build_time,
        rest=", ".join(failures) or "none",
    )


def main() -> None:
    """Solve all scenes."""
    parser = parser_of(__doc__)
    parser.add_argument("--scenes", type=int, default=N_SCENES, metavar="N")
    arguments, run = begin(parser)
    robot = load_robot(ROBOT)
    n = 1 if run.quick else arguments.scenes
    problems = [problem(seed, robot=robot) for seed in range(n)]
    scenes = Scenes(problems[0])
    rows = [row_of(scenes.solved(item)) for item in problems]
    tables = [Table(rows=rows)]
    run.write(
        Report(
            name="ocp_scenes",
            title="Optimal control among obstacles",
            prose=prose(rows, scenes),
            tables=tables,
        )
    )


if __name__ == "__main__":
    main()
