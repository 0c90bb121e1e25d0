"""State estimation: readings in, a state estimate with its age and the health of every channel
out.
"""

from uvms_ocp.estimation.estimator import Estimator as Estimator, PassThrough as PassThrough
from uvms_ocp.estimation.tuning import EstimatorTuning as EstimatorTuning
