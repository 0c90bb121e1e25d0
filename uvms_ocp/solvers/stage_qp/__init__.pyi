from .options import StageQpOptions as StageQpOptions
from .problem import (
    KktResidual as KktResidual,
    StageQp as StageQp,
    StageQpSolution as StageQpSolution,
    StageQpStatus as StageQpStatus,
    StageShape as StageShape,
)
from .solver import StageQpSolver as StageQpSolver
