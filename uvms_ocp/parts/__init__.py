"""Parts of a user's own in a scenario: a plant, sensors, an estimator or a controller in, watched ones out.

    record = replace(scenario, plant=DragPlant(0.2), estimator=ComplementaryFilter, controller=Pid).run()

What each of them is: `uvms_ocp.parts.makers`.
"""

from uvms_ocp.parts.makers import ControllerMaker as ControllerMaker
from uvms_ocp.parts.makers import Disturbance as Disturbance
from uvms_ocp.parts.makers import EstimatorMaker as EstimatorMaker
from uvms_ocp.parts.makers import FaultMaker as FaultMaker
from uvms_ocp.parts.makers import PlantMaker as PlantMaker
from uvms_ocp.parts.makers import SensorsMaker as SensorsMaker
from uvms_ocp.sim.plant import Plant as Plant
