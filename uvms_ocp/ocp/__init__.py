"""Optimal control with ordered levels over a horizon: problems, planners, and plans with a
verdict.
"""

from uvms_ocp.lazy_names import attach_stub
from uvms_ocp.ocp.planner import plan as plan

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
