"""Control layers: what runs at every tick."""

from uvms_ocp.control.kinematic import KinematicController as KinematicController
from uvms_ocp.control.levels import LevelsProblem as LevelsProblem
from uvms_ocp.control.levels import build_levels as build_levels
