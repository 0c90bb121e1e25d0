"""A mission of a robot with a fixed base, no altimeter and no thrusters: the same machinery."""

from __future__ import annotations

import numpy as np
import pytest

from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import Below, Phase, Transition
from uvms_ocp.record.meta_values import DONE
from uvms_ocp.report.summary import summarize
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.joints import JointLimits, JointTracking


@pytest.mark.slow
@pytest.mark.parametrize("plant", ["kinematic", "dynamic"])
def test_a_planar_robot_moves_its_joints_to_a_posture(plant: str) -> None:
    robot = load_robot("planar5")
    goal = np.array([0.3, -0.2, 0.5, 0.4, -0.6])
    reached = Transition(to=DONE, when=(Below(quantity="MP.posture_error", limit=0.01),), hold=0.5)
    tasks = [JointLimits(), JointTracking(joints=robot.joint_names, goal=goal)]
    scenario = Scenario(
        name="posture",
        robot=robot,
        mission=Mission(
            hierarchy=Hierarchy(tasks),
            phases=(Phase(name="A", activations={"JL": 1.0, "MP": 1.0}, transitions=(reached,)),),
        ),
        environment=Environment(seafloor=FlatSeafloor(z=-10.0)),
        start=robot.configuration(),
        plant=plant,
        duration=30.0,
    )
    record = scenario.run()
    report = summarize(record)
    assert report["completed"], report["pending"]
    assert report["vehicle_drift_in_last_phase_m"] is None
    np.testing.assert_allclose(record["q"][-1], goal, atol=0.02)
