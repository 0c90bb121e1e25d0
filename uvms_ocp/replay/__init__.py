"""A plan and a plant in; the record of its flight and how far that departed from the plan out."""

from uvms_ocp.replay.flight import Flight as Flight
from uvms_ocp.replay.flight import replay as replay
