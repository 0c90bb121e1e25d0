"""Lexicographic nonlinear programs, solved level by level: IPOPT, fatrop, SQP in real time."""

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
