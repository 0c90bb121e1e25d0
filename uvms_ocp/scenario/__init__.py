"""Scenarios: robot, mission, environment and solver composed, checked, run; ready-made ones, and
plans carried out on a plant.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
