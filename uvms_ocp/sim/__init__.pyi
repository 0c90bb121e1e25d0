from .bathymetry import Bathymetry as Bathymetry
from .currents import (
    Current as Current,
    GustyCurrent as GustyCurrent,
    OnsetCurrent as OnsetCurrent,
    ShearedCurrent as ShearedCurrent,
    StillWater as StillWater,
    UniformCurrent as UniformCurrent,
    water_at as water_at,
)
from .dynamic_plant import DynamicPlant as DynamicPlant
from .environment import Environment as Environment
from .faults import Fault as Fault, parse_fault as parse_fault
from .loop import simulate as simulate
from .nearest_passage import (
    ClosestApproach as ClosestApproach,
    closest_approach as closest_approach,
)
from .own_parts import (
    ControllerMaker as ControllerMaker,
    Disturbance as Disturbance,
    EstimatorMaker as EstimatorMaker,
    FaultMaker as FaultMaker,
    PlantMaker as PlantMaker,
    SensorsMaker as SensorsMaker,
)
from .plant import KinematicPlant as KinematicPlant, Plant as Plant
from .rough_seafloor import HeightField as HeightField
from .seafloor import (
    FlatSeafloor as FlatSeafloor,
    Seafloor as Seafloor,
    floor_mesh as floor_mesh,
    floor_obstacle as floor_obstacle,
    floor_relief as floor_relief,
)
from .sensors import Altimeter as Altimeter, SensorSuite as SensorSuite
