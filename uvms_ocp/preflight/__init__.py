"""Before a mission: can it be done, and what has to change if not?"""

from uvms_ocp.preflight.checks import check_mission as check_mission
from uvms_ocp.preflight.findings import Finding as Finding
from uvms_ocp.preflight.findings import PreflightReport as PreflightReport
from uvms_ocp.preflight.findings import Severity as Severity
from uvms_ocp.preflight.forecast import forecast as forecast
from uvms_ocp.preflight.setup import Setup as Setup
