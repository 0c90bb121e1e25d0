import uvms_ocp.estimation.estimator
import uvms_ocp.estimation.tuning

from .force.dynamic import DynamicController as DynamicController, VelocityGains as VelocityGains
from .load_filter import LoadLearning as LoadLearning
from .nmpc import Nmpc as Nmpc
from .solve_workers import (
    ProcessWorker as ProcessWorker,
    SynchronousWorker as SynchronousWorker,
    WorkerStatus as WorkerStatus,
)
from .velocity.kinematic import KinematicController as KinematicController
from .velocity.levels import LevelsProblem as LevelsProblem, build_levels as build_levels

Estimator = uvms_ocp.estimation.estimator.Estimator
GateOutcome = uvms_ocp.estimation.estimator.GateOutcome
PassThrough = uvms_ocp.estimation.estimator.PassThrough
EstimatorTuning = uvms_ocp.estimation.tuning.EstimatorTuning
