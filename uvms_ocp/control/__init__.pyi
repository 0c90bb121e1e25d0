import uvms_ocp.estimation.estimator
import uvms_ocp.estimation.filter_memory

from .force.dynamic import DynamicController as DynamicController
from .force.dynamic import VelocityGains as VelocityGains
from .nmpc import Nmpc as Nmpc
from .payload import LoadLearning as LoadLearning
from .solve_workers import ProcessWorker as ProcessWorker
from .solve_workers import SynchronousWorker as SynchronousWorker
from .solve_workers import WorkerStatus as WorkerStatus
from .velocity.kinematic import KinematicController as KinematicController
from .velocity.levels import LevelsProblem as LevelsProblem
from .velocity.levels import build_levels as build_levels

Estimator = uvms_ocp.estimation.estimator.Estimator
GateOutcome = uvms_ocp.estimation.estimator.GateOutcome
PassThrough = uvms_ocp.estimation.estimator.PassThrough
EstimatorTuning = uvms_ocp.estimation.filter_memory.EstimatorTuning
