from .activation import SmoothActivation as SmoothActivation
from .altitude import LandingAltitude as LandingAltitude, MinimumAltitude as MinimumAltitude
from .attitude import (
    Alignment as Alignment,
    FieldOfView as FieldOfView,
    HorizontalAttitude as HorizontalAttitude,
)
from .clearance import Clearance as Clearance
from .hierarchy import Hierarchy as Hierarchy
from .joints import (
    JointLimits as JointLimits,
    JointTracking as JointTracking,
    Manipulability as Manipulability,
)
from .pose import (
    ToolPose as ToolPose,
    ToolPosition as ToolPosition,
    VehiclePose as VehiclePose,
)
from .task import (
    Residual as Residual,
    Rows as Rows,
    Task as Task,
    TaskClass as TaskClass,
    determined_by_goal as determined_by_goal,
    equality_rows as equality_rows,
    zero_residual as zero_residual,
)
from .vehicle_velocity import (
    NullVelocity as NullVelocity,
    UnderActuation as UnderActuation,
)
