"""Many runs, one table: failures are rows, not exceptions."""

from uvms_ocp.campaign.campaign import Campaign as Campaign
from uvms_ocp.campaign.distributions import Choice as Choice
from uvms_ocp.campaign.distributions import LogNormal as LogNormal
from uvms_ocp.campaign.distributions import Normal as Normal
from uvms_ocp.campaign.distributions import Triangular as Triangular
from uvms_ocp.campaign.distributions import Uniform as Uniform
from uvms_ocp.campaign.report import campaign_report as campaign_report
from uvms_ocp.campaign.report import compare_campaigns as compare_campaigns
from uvms_ocp.campaign.store import read_table as read_table
from uvms_ocp.campaign.variations import Variation as Variation
from uvms_ocp.campaign.variations import available_parameters as available_parameters
