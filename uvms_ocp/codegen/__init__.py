"""CasADi functions and kernels, compiled once into a cache and called through fixed memory."""

from uvms_ocp.lazy_names import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
