from .cases.bluerov import bluerov_inspection as bluerov_inspection, reach as reach
from .cases.case1 import (
    Thresholds as Thresholds,
    case1 as case1,
    case1_unreachable as case1_unreachable,
    current_drift as current_drift,
    priority_swap as priority_swap,
    two_targets as two_targets,
)
from .cases.case2 import case2 as case2
from .cases.transit import obstacle_field as obstacle_field, transit as transit
from .options import RunOptions as RunOptions, activate as activate
from .plan_replay import ReplayResult as ReplayResult, replay as replay
from .preflight.checks import check_mission as check_mission
from .preflight.findings import (
    Finding as Finding,
    PreflightReport as PreflightReport,
    Severity as Severity,
)
from .preflight.phase_forecast import (
    forecast as forecast,
)
from .preflight.robot_check import (
    check_robot as check_robot,
    check_robot_files as check_robot_files,
)
from .preflight.setup import (
    Setup as Setup,
)
from .recorded_estimate import (
    RecordedEstimate as RecordedEstimate,
    estimate_recording as estimate_recording,
)
from .scenario import Scenario as Scenario, pose_at as pose_at
