"""Lexicographic nonlinear programs, solved level by level: IPOPT, SQP in real time."""

from uvms_ocp.lazy_names import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
