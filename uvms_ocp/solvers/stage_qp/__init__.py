"""Convex QPs of stages by an interior point around a Riccati recursion, in C; by PIQP without a compiler."""

from uvms_ocp.solvers.stage_qp.problem import KktResidual as KktResidual
from uvms_ocp.solvers.stage_qp.problem import StageQp as StageQp
from uvms_ocp.solvers.stage_qp.problem import StageQpOptions as StageQpOptions
from uvms_ocp.solvers.stage_qp.problem import StageQpSolution as StageQpSolution
from uvms_ocp.solvers.stage_qp.problem import StageQpStatus as StageQpStatus
from uvms_ocp.solvers.stage_qp.problem import StageShape as StageShape
from uvms_ocp.solvers.stage_qp.solver import StageQpSolver as StageQpSolver
