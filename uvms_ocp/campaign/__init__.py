"""Many runs, one table: failures are rows, not exceptions."""

from collections.abc import Callable

from uvms_ocp.campaign.campaign import Campaign as Campaign
from uvms_ocp.campaign.distributions import Choice as Choice
from uvms_ocp.campaign.distributions import LogNormal as LogNormal
from uvms_ocp.campaign.distributions import Normal as Normal
from uvms_ocp.campaign.distributions import Triangular as Triangular
from uvms_ocp.campaign.distributions import Uniform as Uniform
from uvms_ocp.campaign.fault_study import faults as faults
from uvms_ocp.campaign.random_limits import random_limits as random_limits
from uvms_ocp.campaign.random_missions import random_missions as random_missions
from uvms_ocp.campaign.report import campaign_report as campaign_report
from uvms_ocp.campaign.report import compare_campaigns as compare_campaigns
from uvms_ocp.campaign.store import read_table as read_table
from uvms_ocp.campaign.study import Study as Study
from uvms_ocp.campaign.study import StudyResult as StudyResult
from uvms_ocp.campaign.table2 import table2 as table2
from uvms_ocp.campaign.variations import Variation as Variation
from uvms_ocp.campaign.variations import available_parameters as available_parameters

STUDIES: dict[str, Callable[..., Study]] = {
    "table2": table2,
    "random_missions": random_missions,
    "random_limits": random_limits,
    "faults": faults,
}
"""Studies by the name that the command line knows."""
