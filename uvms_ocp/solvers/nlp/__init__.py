"""A nonlinear program with levels in, its solution level by level out."""

from uvms_ocp.solvers.nlp.lexicographic_nlp import LexicographicNlp as LexicographicNlp
from uvms_ocp.solvers.nlp.lexicographic_nlp import LexicographicResult as LexicographicResult
from uvms_ocp.solvers.nlp.nlp_options import NlpOptions as NlpOptions
from uvms_ocp.solvers.nlp.nlp_status import NlpStatus as NlpStatus
from uvms_ocp.solvers.nlp.program import LexicographicProgram as LexicographicProgram
from uvms_ocp.solvers.nlp.program import NlpLevel as NlpLevel
from uvms_ocp.solvers.nlp.program import lexicographic_program as lexicographic_program
from uvms_ocp.solvers.nlp.real_time_sqp import RealTimeSqp as RealTimeSqp
from uvms_ocp.solvers.nlp.real_time_sqp import SqpResult as SqpResult
from uvms_ocp.solvers.nlp.sqp_options import SqpOptions as SqpOptions
