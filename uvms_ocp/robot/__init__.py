"""The machine: where it is, how it moves, what the water does to it."""

from uvms_ocp.robot.assembly import mount as mount
from uvms_ocp.robot.assembly import without_arm as without_arm
from uvms_ocp.robot.dynamics import robot_dynamics as robot_dynamics
from uvms_ocp.robot.hydrodynamics import Water as Water
from uvms_ocp.robot.kinematics import Kinematics as Kinematics
from uvms_ocp.robot.loading import list_robots as list_robots
from uvms_ocp.robot.loading import load_robot as load_robot
from uvms_ocp.robot.robot import Robot as Robot
from uvms_ocp.robot.shapes.obstacles import Obstacle as Obstacle
from uvms_ocp.robot.shapes.obstacles import mesh_shape as mesh_shape
from uvms_ocp.robot.shapes.obstacles import obstacle as obstacle
from uvms_ocp.robot.symbolic_model import SymbolicModel as SymbolicModel
