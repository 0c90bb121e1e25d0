from .problem import (
    KktResidual as KktResidual,
    StageQp as StageQp,
    StageQpOptions as StageQpOptions,
    StageQpSolution as StageQpSolution,
    StageQpStatus as StageQpStatus,
    StageShape as StageShape,
)
from .solver import StageQpSolver as StageQpSolver
