"""Control: state estimates in, commands out; what runs at every tick."""

from uvms_ocp.estimation.estimator import (
    Estimator as Estimator,
    GateOutcome as GateOutcome,
    PassThrough as PassThrough,
)
from uvms_ocp.estimation.tuning import EstimatorTuning as EstimatorTuning
from uvms_ocp.lazy_names import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
__all__ += ["Estimator", "EstimatorTuning", "GateOutcome", "PassThrough"]
