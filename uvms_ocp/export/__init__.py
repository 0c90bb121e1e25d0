"""The controller as files of C: no Python, no allocation, no input or output, libm only."""

from uvms_ocp.export.controller import (
    export_controller as export_controller,
    exported_controller as exported_controller,
)
