"""Missions: phases, their transitions, and the log of why they ended ([Gao2022] figures 3 and 4).

`Mission` is a value without memory. Its memory is `MissionState`, another value: `Mission.step`
maps one to the next.
"""

from uvms_ocp.lazy_names import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
