from .assembly import mount as mount, without_arm as without_arm
from .channels import Channel as Channel, SensorSpec as SensorSpec
from .dynamics import robot_dynamics as robot_dynamics
from .hydrodynamics import Water as Water
from .kinematics import Kinematics as Kinematics
from .loading import (
    example_robot_data as example_robot_data,
    list_robots as list_robots,
    load_robot as load_robot,
    robot_folder as robot_folder,
)
from .robot import Robot as Robot
from .shapes.obstacles import Obstacle as Obstacle, mesh_shape as mesh_shape, obstacle as obstacle
from .signals import (
    IDEAL_SENSORS as IDEAL_SENSORS,
    Command as Command,
    Reading as Reading,
    Readings as Readings,
    SensorSpecs as SensorSpecs,
    State as State,
    StateEstimate as StateEstimate,
    robot_sensors as robot_sensors,
)
from .static_balance import trimmed as trimmed
from .symbolic_model import SymbolicModel as SymbolicModel
from .thrusters import thruster_matrix as thruster_matrix
