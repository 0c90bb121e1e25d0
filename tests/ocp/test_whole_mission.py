"""The whole mission as one problem: thresholds are met at the ends of the phases, where a greedy mission fails too."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from uvms_ocp.model.loading import load_robot
from uvms_ocp.model.state import State
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.whole_mission import WholeMission, whole_mission
from uvms_ocp.scenario import pose_at
from uvms_ocp.solvers.nlp.lexicographic_nlp import NlpOptions

TARGET = np.array([12.2025, 37.3748, -39.886])


def test_a_way_point_from_which_a_greedy_mission_cannot_reach_the_target_is_no_obstacle() -> None:
    robot = load_robot("girona_maris7_full")
    begin = pose_at((8.5, 38.5, -36.0), (0.0, -0.06, 0.5))
    q = robot.configuration(position=begin.translation, quaternion=pin.Quaternion(begin.rotation).coeffs())
    mission = WholeMission(
        way_point=pose_at((10.2, 37.5, -38.0), (0.0, -0.06, 0.5)),
        target=TARGET,
        tool_goal=pose_at(tuple(TARGET), (np.pi, 0.0, 0.0)),
        durations=((5.0, 20.0), (2.0, 6.0), (4.0, 14.0), (4.0, 14.0)),
        n_steps=(16, 6, 10, 10),
    )
    problem = whole_mission(robot, State(q=q, v=np.zeros(robot.n_v)), mission, floor=-40.0)
    plan = Planner(problem, NlpOptions(max_iterations=400, convergence=1e-5, time_limit=600.0)).plan()
    assert plan.status is OcpStatus.SOLVED
    assert plan.duration <= 54.0
    data, nodes = robot.model.createData(), problem.starts_of_phases()
    poses = []
    for node in nodes[1:]:
        pin.framesForwardKinematics(robot.model, data, plan.trajectory.q[node])
        poses.append({name: data.oMf[robot.frame_id(name)].copy() for name in ("base_link", "altimeter", "tool")})
    way_point = np.linalg.norm(poses[0]["base_link"].translation - mission.way_point.translation)
    assert way_point < mission.arrival + 1e-5
    assert abs(poses[2]["altimeter"].translation[2] + 40.0 - mission.altitude) < 1e-4
    assert np.linalg.norm(poses[3]["tool"].translation - TARGET) < 1e-4
    assert np.abs(plan.trajectory.v[nodes[3] :, :6]).max() < 1e-4
    heights = plan.trajectory.q[1 : nodes[2], 2]
    assert heights.min() > -40.0 + mission.minimum_altitude
