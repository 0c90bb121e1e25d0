"""Control: state estimates in, commands out; what runs at every tick."""

from uvms_ocp.control.force.dynamic import DynamicController as DynamicController
from uvms_ocp.control.force.dynamic import VelocityGains as VelocityGains
from uvms_ocp.control.nmpc import Nmpc as Nmpc
from uvms_ocp.control.payload import LoadLearning as LoadLearning
from uvms_ocp.control.solve_workers import ProcessWorker as ProcessWorker
from uvms_ocp.control.solve_workers import SynchronousWorker as SynchronousWorker
from uvms_ocp.control.solve_workers import WorkerStatus as WorkerStatus
from uvms_ocp.control.velocity.kinematic import KinematicController as KinematicController
from uvms_ocp.control.velocity.levels import LevelsProblem as LevelsProblem
from uvms_ocp.control.velocity.levels import build_levels as build_levels
from uvms_ocp.estimation.estimator import Estimator as Estimator
from uvms_ocp.estimation.estimator import GateOutcome as GateOutcome
from uvms_ocp.estimation.estimator import PassThrough as PassThrough
from uvms_ocp.estimation.filter_memory import EstimatorTuning as EstimatorTuning
