from .checks import check_mission as check_mission
from .findings import (
    Finding as Finding,
    PreflightReport as PreflightReport,
    Severity as Severity,
)
from .phase_forecast import forecast as forecast
from .setup import Setup as Setup
