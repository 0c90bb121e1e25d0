"""Scenarios: robot, mission, environment and solver composed, checked, run; ready-made ones, and
plans carried out on a plant.
"""

from uvms_ocp.lazy_names import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
