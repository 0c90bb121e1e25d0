"""Task-priority planning and optimal control of underwater vehicle-manipulator systems.

Public names; notation and frames: `uvms_ocp.model.spatial`.
"""

from uvms_ocp import scenarios as scenarios
from uvms_ocp.control.velocity.kinematic import KinematicController as KinematicController
from uvms_ocp.exceptions import UvmsError as UvmsError
from uvms_ocp.export.controller import export_controller as export_controller
from uvms_ocp.mission.conditions import DONE as DONE
from uvms_ocp.mission.conditions import Above as Above
from uvms_ocp.mission.conditions import Below as Below
from uvms_ocp.mission.conditions import Transition as Transition
from uvms_ocp.mission.mission import Mission as Mission
from uvms_ocp.mission.phase import Phase as Phase
from uvms_ocp.mission_plan.planning import plan_mission as plan_mission
from uvms_ocp.model.assembly.mounting import mount as mount
from uvms_ocp.model.assembly.mounting import without_arm as without_arm
from uvms_ocp.model.dynamics import robot_dynamics as robot_dynamics
from uvms_ocp.model.files.library import list_robots as list_robots
from uvms_ocp.model.kinematics import Kinematics as Kinematics
from uvms_ocp.model.loading import load_robot as load_robot
from uvms_ocp.model.robot import Robot as Robot
from uvms_ocp.model.symbolic.tree import SymbolicModel as SymbolicModel
from uvms_ocp.model.water.hydrodynamics import Water as Water
from uvms_ocp.record import Record as Record
from uvms_ocp.report.summary import summarize as summarize
from uvms_ocp.scenario import Scenario as Scenario
from uvms_ocp.scenario import pose_at as pose_at
from uvms_ocp.sim.currents import UniformCurrent as UniformCurrent
from uvms_ocp.sim.environment import Environment as Environment
from uvms_ocp.sim.seafloor import FlatSeafloor as FlatSeafloor
from uvms_ocp.solvers.hierarchy.active_set.solver import (
    LexicographicActiveSet as LexicographicActiveSet,
)
from uvms_ocp.solvers.hierarchy.cascade.solver import LexicographicQp as LexicographicQp
from uvms_ocp.solvers.hierarchy.icat import Icat as Icat
from uvms_ocp.solvers.hierarchy.level import Level as Level
from uvms_ocp.solvers.hierarchy.solution import Solution as Solution
from uvms_ocp.solvers.hierarchy.solution import Status as Status
from uvms_ocp.tasks.hierarchy import Hierarchy as Hierarchy
from uvms_ocp.version import __version__ as __version__
