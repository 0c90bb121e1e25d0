"""The simulated water: environment, sensors, plants, faults, the closed loop, and parts of a user.

    record = replace(scenario, plant=DragPlant(0.2), estimator=ComplementaryFilter,
    controller=Pid).run()

What makes such parts: `uvms_ocp.sim.own_parts`.
"""

from uvms_ocp.lazy_names import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
