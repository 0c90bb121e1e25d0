"""Trajectories as functions of time: polynomials, minimum snap, segment times."""

import lazy_loader

from uvms_ocp.trajectories.min_snap import min_snap as min_snap

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
