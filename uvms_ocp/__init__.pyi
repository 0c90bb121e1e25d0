from . import (
    campaign as campaign,
    control as control,
    estimation as estimation,
    export as export,
    identification as identification,
    mission as mission,
    mission_plan as mission_plan,
    ocp as ocp,
    planning as planning,
    record as record,
    report as report,
    robot as robot,
    scenario as scenario,
    sim as sim,
    solvers as solvers,
    tasks as tasks,
    trajectories as trajectories,
    viz as viz,
)
from .control.velocity.kinematic import KinematicController as KinematicController
from .errors import UvmsError as UvmsError
from .export.controller import export_controller as export_controller
from .interrupts import Interrupted as Interrupted
from .mission.mission import Mission as Mission
from .mission.phase import Above as Above, Below as Below, Phase as Phase, Transition as Transition
from .mission_plan.planner import plan_mission as plan_mission
from .progress import show_progress as show_progress
from .record.meta_values import DONE as DONE
from .record.record import Record as Record
from .report.summary import summarize as summarize
from .robot.assembly import mount as mount, without_arm as without_arm
from .robot.dynamics import robot_dynamics as robot_dynamics
from .robot.hydrodynamics import Water as Water
from .robot.kinematics import Kinematics as Kinematics
from .robot.loading import list_robots as list_robots, load_robot as load_robot
from .robot.robot import Robot as Robot
from .robot.symbolic_model import SymbolicModel as SymbolicModel
from .scenario.scenario import Scenario as Scenario, pose_at as pose_at
from .sim.currents import UniformCurrent as UniformCurrent
from .sim.environment import Environment as Environment
from .sim.seafloor import FlatSeafloor as FlatSeafloor
from .solvers.hierarchy.active_set import LexicographicActiveSet as LexicographicActiveSet
from .solvers.hierarchy.cascade import LexicographicQp as LexicographicQp
from .solvers.hierarchy.icat import Icat as Icat
from .solvers.hierarchy.level import Level as Level
from .solvers.hierarchy.solution import Solution as Solution, Status as Status
from .tasks.hierarchy import Hierarchy as Hierarchy
from .version import __version__ as __version__
