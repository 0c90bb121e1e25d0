from .lexicographic_nlp import (
    LexicographicNlp as LexicographicNlp,
    LexicographicResult as LexicographicResult,
)
from .options import NlpOptions as NlpOptions, SqpOptions as SqpOptions
from .program import (
    LexicographicProgram as LexicographicProgram,
    NlpLevel as NlpLevel,
    NlpStatus as NlpStatus,
    lexicographic_program as lexicographic_program,
)
from .real_time_sqp import RealTimeSqp as RealTimeSqp, SqpResult as SqpResult
