"""Solvers of levels, of lexicographic programs and of QPs of stages: pure maths that knows no
robot.
"""

from uvms_ocp.lazy_names import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
