"""Measurements in, commands out: what runs at every tick."""

from uvms_ocp.control.force.dynamic import DynamicController as DynamicController
from uvms_ocp.control.force.dynamic import VelocityGains as VelocityGains
from uvms_ocp.control.load.learning import LoadLearning as LoadLearning
from uvms_ocp.control.navigation.estimator import Estimator as Estimator
from uvms_ocp.control.navigation.outcome import Outcome as Outcome
from uvms_ocp.control.navigation.pass_through import PassThrough as PassThrough
from uvms_ocp.control.navigation.tuning import EstimatorTuning as EstimatorTuning
from uvms_ocp.control.receding.nmpc import Nmpc as Nmpc
from uvms_ocp.control.receding.workers import Beside as Beside
from uvms_ocp.control.receding.workers import InLine as InLine
from uvms_ocp.control.receding.workers import WorkerStatus as WorkerStatus
from uvms_ocp.control.velocity.kinematic import KinematicController as KinematicController
from uvms_ocp.control.velocity.levels import LevelsProblem as LevelsProblem
from uvms_ocp.control.velocity.levels import build_levels as build_levels
