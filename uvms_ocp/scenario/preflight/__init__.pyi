from .checks import check_mission as check_mission
from .setup import (
    Finding as Finding,
    PreflightReport as PreflightReport,
    Setup as Setup,
    Severity as Severity,
    forecast as forecast,
)
