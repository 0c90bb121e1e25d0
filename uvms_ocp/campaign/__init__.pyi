from .campaign import Campaign as Campaign
from .distributions import (
    Choice as Choice,
    LogNormal as LogNormal,
    Normal as Normal,
    Triangular as Triangular,
    Uniform as Uniform,
)
from .paired_comparison import compare_campaigns as compare_campaigns
from .report import campaign_report as campaign_report
from .store import read_table as read_table
from .variations import (
    Variation as Variation,
    available_parameters as available_parameters,
    vary as vary,
)
