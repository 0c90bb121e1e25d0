"""The simulated water: environment, sensors, plants, faults, the closed loop, and parts of a user.

    record = replace(scenario, plant=DragPlant(0.2), estimator=ComplementaryFilter, controller=Pid).run()

What makes such parts: `uvms_ocp.sim.own_parts`.
"""

from uvms_ocp.sim.bathymetry import Bathymetry as Bathymetry
from uvms_ocp.sim.currents import Current as Current
from uvms_ocp.sim.currents import GustyCurrent as GustyCurrent
from uvms_ocp.sim.currents import OnsetCurrent as OnsetCurrent
from uvms_ocp.sim.currents import ShearedCurrent as ShearedCurrent
from uvms_ocp.sim.currents import StillWater as StillWater
from uvms_ocp.sim.currents import UniformCurrent as UniformCurrent
from uvms_ocp.sim.currents import water_at as water_at
from uvms_ocp.sim.environment import ClosestApproach as ClosestApproach
from uvms_ocp.sim.environment import Environment as Environment
from uvms_ocp.sim.environment import closest_approach as closest_approach
from uvms_ocp.sim.faults import Fault as Fault
from uvms_ocp.sim.faults import parse_fault as parse_fault
from uvms_ocp.sim.loop import simulate as simulate
from uvms_ocp.sim.own_parts import ControllerMaker as ControllerMaker
from uvms_ocp.sim.own_parts import Disturbance as Disturbance
from uvms_ocp.sim.own_parts import EstimatorMaker as EstimatorMaker
from uvms_ocp.sim.own_parts import FaultMaker as FaultMaker
from uvms_ocp.sim.own_parts import PlantMaker as PlantMaker
from uvms_ocp.sim.own_parts import SensorsMaker as SensorsMaker
from uvms_ocp.sim.plant import DynamicPlant as DynamicPlant
from uvms_ocp.sim.plant import KinematicPlant as KinematicPlant
from uvms_ocp.sim.plant import Plant as Plant
from uvms_ocp.sim.seafloor import FlatSeafloor as FlatSeafloor
from uvms_ocp.sim.seafloor import HeightField as HeightField
from uvms_ocp.sim.seafloor import Seafloor as Seafloor
from uvms_ocp.sim.seafloor import floor_mesh as floor_mesh
from uvms_ocp.sim.seafloor import floor_obstacle as floor_obstacle
from uvms_ocp.sim.seafloor import floor_relief as floor_relief
from uvms_ocp.sim.sensors import Altimeter as Altimeter
from uvms_ocp.sim.sensors import SensorSuite as SensorSuite
