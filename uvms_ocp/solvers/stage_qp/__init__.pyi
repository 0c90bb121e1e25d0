from .problem import KktResidual as KktResidual
from .problem import StageQp as StageQp
from .problem import StageQpOptions as StageQpOptions
from .problem import StageQpSolution as StageQpSolution
from .problem import StageQpStatus as StageQpStatus
from .problem import StageShape as StageShape
from .solver import StageQpSolver as StageQpSolver
