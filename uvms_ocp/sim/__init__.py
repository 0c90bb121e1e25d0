"""The simulated water: floor, sensors, plants and the closed loop."""

from uvms_ocp.sim.environment import FlatSeafloor as FlatSeafloor
from uvms_ocp.sim.loop import simulate as simulate
from uvms_ocp.sim.plant import Altimeter as Altimeter
from uvms_ocp.sim.plant import KinematicPlant as KinematicPlant
