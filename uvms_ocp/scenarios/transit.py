"""A low transit over a rough floor: one cell of Table 2 of the paper."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from uvms_ocp.arguments import Positive, Range, checked
from uvms_ocp.mission.conditions import DONE, Below, Transition
from uvms_ocp.mission.phase import Phase
from uvms_ocp.scenario import Scenario, pose_at
from uvms_ocp.scenarios.parts import abort_phase, mission_of, on
from uvms_ocp.scenarios.run_options import run_options
from uvms_ocp.sim.height_field import HeightField
from uvms_ocp.tasks.altitude import MinimumAltitude
from uvms_ocp.tasks.attitude import HorizontalAttitude
from uvms_ocp.tasks.joints import JointLimits
from uvms_ocp.tasks.pose import VehiclePose

_ABOVE_FLOOR = 0.8  # [m] height of the way point: low enough for the minimum altitude to decide the height everywhere

Length = Annotated[float, Range(0.0, 2000.0)]
"""[m] Of a transit: its floor is drawn whole."""


@checked
def transit(*, relief: str = "small", min_altitude: Positive = 1.0, length: Length = 30.0, **options: Any) -> Scenario:
    """A transit of length [m] towards a way point near the floor, held up by the minimum altitude alone.

    relief: a name in `uvms_ocp.sim.height_field.RELIEFS`. min_altitude [m]: h_min. The floor is drawn from `seed`. The
    altimeter looks straight down and sees a slope only when above it: over steep protuberances a low minimum is not
    safe. options: those of `RunOptions`.
    """
    run = run_options(options)
    floor = HeightField.random(relief, z=run.seabed, centre=(length / 2, 0.0), extent=length + 20.0, seed=run.seed)
    ground = max(floor.height(x, y) for x in np.linspace(-2.0, 2.0, 9) for y in np.linspace(-1.0, 1.0, 5))
    goal = pose_at((length, 0.0, max(run.seabed, floor.height(length, 0.0)) + _ABOVE_FLOOR))
    tasks = [
        JointLimits(),
        MinimumAltitude(threshold=min_altitude, margin=1.0),
        HorizontalAttitude(),
        VehiclePose(goal=goal),
    ]
    arrived = Below(quantity="PC.horizontal_error", limit=1.0)
    phase = Phase(
        name="A",
        title="transit",
        gates=on("JL", "MAC", "HA", "PC"),
        transitions=(Transition(to=DONE, when=(arrived,)),),
    )
    return run.scenario(
        name="transit",
        mission=mission_of(run.robot, tasks, (phase,), abort=abort_phase("JL", "MAC", "HA")),
        start=run.start(pose_at((0.0, 0.0, ground + min_altitude + 1.5))),
        seafloor=floor,
        markers={"way point": tuple(goal.translation.tolist())},
    )
