"""The machine: where it is, how it moves, what the water does to it."""

from uvms_ocp.robot.assembly import mount as mount
from uvms_ocp.robot.assembly import trimmed as trimmed
from uvms_ocp.robot.assembly import without_arm as without_arm
from uvms_ocp.robot.dynamics import robot_dynamics as robot_dynamics
from uvms_ocp.robot.hydrodynamics import Water as Water
from uvms_ocp.robot.kinematics import Kinematics as Kinematics
from uvms_ocp.robot.loading import example_robot_data as example_robot_data
from uvms_ocp.robot.loading import list_robots as list_robots
from uvms_ocp.robot.loading import load_robot as load_robot
from uvms_ocp.robot.loading import robot_folder as robot_folder
from uvms_ocp.robot.robot import Robot as Robot
from uvms_ocp.robot.shapes.obstacles import Obstacle as Obstacle
from uvms_ocp.robot.shapes.obstacles import mesh_shape as mesh_shape
from uvms_ocp.robot.shapes.obstacles import obstacle as obstacle
from uvms_ocp.robot.signals import IDEAL_SENSORS as IDEAL_SENSORS
from uvms_ocp.robot.signals import Command as Command
from uvms_ocp.robot.signals import Reading as Reading
from uvms_ocp.robot.signals import Readings as Readings
from uvms_ocp.robot.signals import SensorSpec as SensorSpec
from uvms_ocp.robot.signals import SensorSpecs as SensorSpecs
from uvms_ocp.robot.signals import State as State
from uvms_ocp.robot.signals import StateEstimate as StateEstimate
from uvms_ocp.robot.signals import robot_sensors as robot_sensors
from uvms_ocp.robot.symbolic_model import SymbolicModel as SymbolicModel
from uvms_ocp.robot.thrusters import thruster_matrix as thruster_matrix
