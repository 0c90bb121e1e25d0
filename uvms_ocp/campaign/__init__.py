"""Many runs, one table: failures are rows, not exceptions."""

from collections.abc import Callable

from uvms_ocp.campaign.fault_study import faults as faults
from uvms_ocp.campaign.random_limits import random_limits as random_limits
from uvms_ocp.campaign.random_missions import random_missions as random_missions
from uvms_ocp.campaign.study import Study as Study
from uvms_ocp.campaign.study import StudyResult as StudyResult
from uvms_ocp.campaign.table2 import table2 as table2

STUDIES: dict[str, Callable[..., Study]] = {
    "table2": table2,
    "random_missions": random_missions,
    "random_limits": random_limits,
    "faults": faults,
}
"""Studies by the name that the command line knows."""
