"""Task-priority planning and optimal control of underwater vehicle-manipulator systems.

Public names; notation and frames: `uvms_ocp.model.spatial`.
"""

from uvms_ocp import scenarios as scenarios
from uvms_ocp.control import KinematicController as KinematicController
from uvms_ocp.exceptions import UvmsError as UvmsError
from uvms_ocp.mission import DONE as DONE
from uvms_ocp.mission import Above as Above
from uvms_ocp.mission import Below as Below
from uvms_ocp.mission import Mission as Mission
from uvms_ocp.mission import Phase as Phase
from uvms_ocp.mission import Transition as Transition
from uvms_ocp.model.dynamics import robot_dynamics as robot_dynamics
from uvms_ocp.model.hydrodynamics import Water as Water
from uvms_ocp.model.kinematics import Kinematics as Kinematics
from uvms_ocp.model.mounting import mount as mount
from uvms_ocp.model.mounting import without_arm as without_arm
from uvms_ocp.model.robot import Robot as Robot
from uvms_ocp.model.robot import list_robots as list_robots
from uvms_ocp.model.robot import load_robot as load_robot
from uvms_ocp.model.symbolic import SymbolicModel as SymbolicModel
from uvms_ocp.record import Record as Record
from uvms_ocp.report import summarize as summarize
from uvms_ocp.scenario import Scenario as Scenario
from uvms_ocp.scenario import pose_at as pose_at
from uvms_ocp.sim import Environment as Environment
from uvms_ocp.sim import FlatSeafloor as FlatSeafloor
from uvms_ocp.sim import UniformCurrent as UniformCurrent
from uvms_ocp.solvers import Icat as Icat
from uvms_ocp.solvers import Level as Level
from uvms_ocp.solvers import LexicographicActiveSet as LexicographicActiveSet
from uvms_ocp.solvers import LexicographicQp as LexicographicQp
from uvms_ocp.solvers import Solution as Solution
from uvms_ocp.solvers import Status as Status
from uvms_ocp.tasks import Hierarchy as Hierarchy
from uvms_ocp.version import __version__ as __version__
