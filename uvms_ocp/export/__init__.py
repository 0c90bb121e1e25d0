"""What runs without Python, from a scenario."""

from uvms_ocp.export.controller import export_controller as export_controller
from uvms_ocp.export.controller import exported_controller as exported_controller
