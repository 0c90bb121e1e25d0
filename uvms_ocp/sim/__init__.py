"""The simulated water: environment, sensors, plants, faults, the closed loop, and parts of a user.

    record = replace(scenario, plant=DragPlant(0.2), estimator=ComplementaryFilter,
    controller=Pid).run()

What makes such parts: `uvms_ocp.sim.own_parts`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
