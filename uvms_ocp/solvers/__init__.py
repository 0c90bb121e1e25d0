"""Solvers of levels, of lexicographic programs and of QPs of stages: pure maths that knows no robot."""

from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet as LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.cascade import LexicographicQp as LexicographicQp
from uvms_ocp.solvers.hierarchy.icat import Icat as Icat
from uvms_ocp.solvers.hierarchy.level import Level as Level
from uvms_ocp.solvers.hierarchy.solution import Solution as Solution
from uvms_ocp.solvers.hierarchy.solution import Status as Status
from uvms_ocp.solvers.hierarchy.solution import Tick as Tick
from uvms_ocp.solvers.hierarchy.solution import TickResult as TickResult
from uvms_ocp.solvers.nlp.level_solver import NlpOptions as NlpOptions
from uvms_ocp.solvers.nlp.level_solver import SqpOptions as SqpOptions
from uvms_ocp.solvers.nlp.lexicographic_nlp import LexicographicNlp as LexicographicNlp
from uvms_ocp.solvers.nlp.lexicographic_nlp import LexicographicResult as LexicographicResult
from uvms_ocp.solvers.nlp.program import LexicographicProgram as LexicographicProgram
from uvms_ocp.solvers.nlp.program import NlpLevel as NlpLevel
from uvms_ocp.solvers.nlp.program import NlpStatus as NlpStatus
from uvms_ocp.solvers.nlp.program import lexicographic_program as lexicographic_program
from uvms_ocp.solvers.nlp.real_time_sqp import RealTimeSqp as RealTimeSqp
from uvms_ocp.solvers.nlp.real_time_sqp import SqpResult as SqpResult
from uvms_ocp.solvers.stage_qp.problem import StageQp as StageQp
from uvms_ocp.solvers.stage_qp.problem import StageQpOptions as StageQpOptions
from uvms_ocp.solvers.stage_qp.problem import StageQpSolution as StageQpSolution
from uvms_ocp.solvers.stage_qp.problem import StageQpStatus as StageQpStatus
from uvms_ocp.solvers.stage_qp.problem import StageShape as StageShape
from uvms_ocp.solvers.stage_qp.solver import StageQpSolver as StageQpSolver
