"""Convex quadratic programs of stages, one after the other in time, in; their optimum out: in C, or in NumPy."""

from uvms_ocp.solvers.stagewise.options import StageQpOptions as StageQpOptions
from uvms_ocp.solvers.stagewise.solution import KktResidual as KktResidual
from uvms_ocp.solvers.stagewise.solution import StageQpSolution as StageQpSolution
from uvms_ocp.solvers.stagewise.solution import StageQpStatus as StageQpStatus
from uvms_ocp.solvers.stagewise.stage_qp import StageQp as StageQp
from uvms_ocp.solvers.stagewise.stage_qp import StageShape as StageShape
from uvms_ocp.solvers.stagewise.stage_qp_solver import StageQpSolver as StageQpSolver
