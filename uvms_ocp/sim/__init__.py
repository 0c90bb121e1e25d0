"""The simulated water: environment, sensors, plants and the closed loop."""

from uvms_ocp.sim.closest_approach import ClosestApproach as ClosestApproach
from uvms_ocp.sim.closest_approach import closest_approach as closest_approach
from uvms_ocp.sim.currents import Current as Current
from uvms_ocp.sim.currents import GustyCurrent as GustyCurrent
from uvms_ocp.sim.currents import OnsetCurrent as OnsetCurrent
from uvms_ocp.sim.currents import ShearedCurrent as ShearedCurrent
from uvms_ocp.sim.currents import StillWater as StillWater
from uvms_ocp.sim.currents import UniformCurrent as UniformCurrent
from uvms_ocp.sim.currents import water_at as water_at
from uvms_ocp.sim.dynamic_plant import DynamicPlant as DynamicPlant
from uvms_ocp.sim.environment import Environment as Environment
from uvms_ocp.sim.faults import Fault as Fault
from uvms_ocp.sim.faults import parse_fault as parse_fault
from uvms_ocp.sim.height_field import HeightField as HeightField
from uvms_ocp.sim.loop import simulate as simulate
from uvms_ocp.sim.plant import KinematicPlant as KinematicPlant
from uvms_ocp.sim.seafloor import FlatSeafloor as FlatSeafloor
from uvms_ocp.sim.seafloor import Seafloor as Seafloor
from uvms_ocp.sim.seafloor import floor_mesh as floor_mesh
from uvms_ocp.sim.seafloor import floor_obstacle as floor_obstacle
from uvms_ocp.sim.seafloor import floor_relief as floor_relief
from uvms_ocp.sim.sensors import Altimeter as Altimeter
from uvms_ocp.sim.sensors import SensorSuite as SensorSuite
