from .checks import check_mission as check_mission
from .setup import Finding as Finding
from .setup import PreflightReport as PreflightReport
from .setup import Setup as Setup
from .setup import Severity as Severity
from .setup import forecast as forecast
