"""Optimal control with ordered levels over a horizon: problems, planners, and plans with a
verdict.
"""

import lazy_loader

from uvms_ocp.ocp.planner import plan as plan

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
