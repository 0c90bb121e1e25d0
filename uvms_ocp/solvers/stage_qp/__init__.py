"""Convex QPs of stages by an interior point around a Riccati recursion, in C; by PIQP without a
compiler.
"""

from uvms_ocp.lazy_names import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
