"""Tasks: what is wanted of the robot, one file per family."""

from uvms_ocp.tasks.activation import SmoothActivation as SmoothActivation
from uvms_ocp.tasks.altitude import LandingAltitude as LandingAltitude
from uvms_ocp.tasks.altitude import MinimumAltitude as MinimumAltitude
from uvms_ocp.tasks.attitude import Alignment as Alignment
from uvms_ocp.tasks.attitude import FieldOfView as FieldOfView
from uvms_ocp.tasks.attitude import HorizontalAttitude as HorizontalAttitude
from uvms_ocp.tasks.clearance import Clearance as Clearance
from uvms_ocp.tasks.joints import JointLimits as JointLimits
from uvms_ocp.tasks.joints import JointTracking as JointTracking
from uvms_ocp.tasks.joints import Manipulability as Manipulability
from uvms_ocp.tasks.pose import NullVelocity as NullVelocity
from uvms_ocp.tasks.pose import ToolPose as ToolPose
from uvms_ocp.tasks.pose import ToolPosition as ToolPosition
from uvms_ocp.tasks.pose import UnderActuation as UnderActuation
from uvms_ocp.tasks.pose import VehiclePose as VehiclePose
from uvms_ocp.tasks.task import Hierarchy as Hierarchy
from uvms_ocp.tasks.task import Residual as Residual
from uvms_ocp.tasks.task import Rows as Rows
from uvms_ocp.tasks.task import Task as Task
from uvms_ocp.tasks.task import TaskClass as TaskClass
from uvms_ocp.tasks.task import equality_rows as equality_rows
from uvms_ocp.tasks.task import zero_residual as zero_residual
