"""Code of someone who uses the package, to be looked at by a strict type checker; it is never
run.
"""

import numpy as np

import uvms_ocp as uo
from uvms_ocp.tasks import HorizontalAttitude, MinimumAltitude, VehiclePose
from uvms_ocp.viz import plot, show


def mission(robot: uo.Robot) -> uo.Scenario:
    goal = uo.pose_at((2.0, 0.0, -6.0))
    hierarchy = uo.Hierarchy(
        [VehiclePose(goal=goal), MinimumAltitude(threshold=1.5), HorizontalAttitude()]
    )
    reached = uo.Transition(to=uo.DONE, when=(uo.Below(quantity="PC.position_error", limit=0.05),))
    phase = uo.Phase(name="go", activations={"PC": 1, "MAC": 1, "HA": 1}, transitions=(reached,))
    return uo.Scenario(
        name="go",
        robot=robot,
        mission=uo.Mission(hierarchy=hierarchy, phases=(phase,)),
        environment=uo.Environment(
            seafloor=uo.FlatSeafloor(z=-10.0), current=uo.UniformCurrent(np.array([0.1, 0.0, 0.0]))
        ),
        start=robot.configuration(position=(0, 0, -5)),
        solver=uo.LexicographicActiveSet(),
    )


record: uo.Record = mission(uo.load_robot("girona_maris7")).run()
error: np.ndarray = record["PC.position_error"]
plot(record, "PC.position_error").savefig("error.pdf")
print(len(plot(record)), show(record).html[:10], uo.summarize(record)["completed"])
