"""Pre-flight: can a mission be done, and what has to change if not."""

from uvms_ocp.scenario.preflight.checks import check_mission as check_mission
from uvms_ocp.scenario.preflight.setup import Finding as Finding
from uvms_ocp.scenario.preflight.setup import PreflightReport as PreflightReport
from uvms_ocp.scenario.preflight.setup import Setup as Setup
from uvms_ocp.scenario.preflight.setup import Severity as Severity
from uvms_ocp.scenario.preflight.setup import forecast as forecast
