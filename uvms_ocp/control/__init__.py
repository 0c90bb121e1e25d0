"""Control layers: what runs at every tick."""

from uvms_ocp.control.dynamic import DynamicController as DynamicController
from uvms_ocp.control.dynamic import VelocityGains as VelocityGains
from uvms_ocp.control.estimator import Estimator as Estimator
from uvms_ocp.control.estimator import EstimatorTuning as EstimatorTuning
from uvms_ocp.control.estimator import PassThrough as PassThrough
from uvms_ocp.control.kinematic import KinematicController as KinematicController
from uvms_ocp.control.levels import LevelsProblem as LevelsProblem
from uvms_ocp.control.levels import build_levels as build_levels
