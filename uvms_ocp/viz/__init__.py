"""Figures and 3-D scenes of a `Record`; the only package that imports Matplotlib and meshcat."""

from uvms_ocp.lazy_names import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
