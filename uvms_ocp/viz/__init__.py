"""Figures and 3-D scenes of a `Record`; the only package that imports Matplotlib and meshcat."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
