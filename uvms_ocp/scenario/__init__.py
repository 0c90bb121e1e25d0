"""Scenarios: robot, mission, environment and solver composed, checked, run; ready-made ones, and plans carried out on a plant."""

from uvms_ocp.scenario.cases.bluerov import bluerov_inspection as bluerov_inspection
from uvms_ocp.scenario.cases.bluerov import reach as reach
from uvms_ocp.scenario.cases.case1 import Thresholds as Thresholds
from uvms_ocp.scenario.cases.case1 import case1 as case1
from uvms_ocp.scenario.cases.case1 import case1_unreachable as case1_unreachable
from uvms_ocp.scenario.cases.case1 import current_drift as current_drift
from uvms_ocp.scenario.cases.case1 import priority_swap as priority_swap
from uvms_ocp.scenario.cases.case1 import two_targets as two_targets
from uvms_ocp.scenario.cases.case2 import case2 as case2
from uvms_ocp.scenario.cases.transit import obstacle_field as obstacle_field
from uvms_ocp.scenario.cases.transit import transit as transit
from uvms_ocp.scenario.options import RunOptions as RunOptions
from uvms_ocp.scenario.options import activate as activate
from uvms_ocp.scenario.preflight.checks import check_mission as check_mission
from uvms_ocp.scenario.preflight.robot_check import check_robot as check_robot
from uvms_ocp.scenario.preflight.robot_check import check_robot_files as check_robot_files
from uvms_ocp.scenario.preflight.setup import Finding as Finding
from uvms_ocp.scenario.preflight.setup import PreflightReport as PreflightReport
from uvms_ocp.scenario.preflight.setup import Setup as Setup
from uvms_ocp.scenario.preflight.setup import Severity as Severity
from uvms_ocp.scenario.preflight.setup import forecast as forecast
from uvms_ocp.scenario.replay import ReplayResult as ReplayResult
from uvms_ocp.scenario.replay import replay as replay
from uvms_ocp.scenario.scenario import Scenario as Scenario
from uvms_ocp.scenario.scenario import pose_at as pose_at
