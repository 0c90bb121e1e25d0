from .hierarchy.active_set import LexicographicActiveSet as LexicographicActiveSet
from .hierarchy.cascade import LexicographicQp as LexicographicQp
from .hierarchy.icat import Icat as Icat
from .hierarchy.level import Level as Level
from .hierarchy.solution import (
    Solution as Solution,
    Status as Status,
    Tick as Tick,
    TickResult as TickResult,
)
from .nlp.lexicographic_nlp import (
    LexicographicNlp as LexicographicNlp,
    LexicographicResult as LexicographicResult,
)
from .nlp.options import NlpOptions as NlpOptions, SqpOptions as SqpOptions
from .nlp.program import (
    LexicographicProgram as LexicographicProgram,
    NlpLevel as NlpLevel,
    NlpStatus as NlpStatus,
    lexicographic_program as lexicographic_program,
)
from .nlp.real_time_sqp import RealTimeSqp as RealTimeSqp, SqpResult as SqpResult
from .stage_qp.options import StageQpOptions as StageQpOptions
from .stage_qp.problem import (
    StageQp as StageQp,
    StageQpSolution as StageQpSolution,
    StageQpStatus as StageQpStatus,
    StageShape as StageShape,
)
from .stage_qp.solver import StageQpSolver as StageQpSolver
