from .calibration import Calibration as Calibration, calibrate as calibrate
from .calibration_robot import (
    CalibratedRobot as CalibratedRobot,
    calibrated_robot as calibrated_robot,
)
from .channel_mapping import (
    RecordingMapping as RecordingMapping,
    read_mapping as read_mapping,
)
from .data_quality import check_data_quality as check_data_quality
from .estimates import Noise as Noise
from .experiment_design import (
    DesignSettings as DesignSettings,
    ExperimentTask as ExperimentTask,
    design_experiment as design_experiment,
)
from .experiment_limits import ExperimentLimits as ExperimentLimits
from .identified_numbers import (
    IdentifiedNumber as IdentifiedNumber,
    values_of as values_of,
)
from .mapped_recordings import mapped_recording as mapped_recording
from .model import Vehicle as Vehicle, stage_of as stage_of
from .parameters import AXES as AXES
from .predictor import Predictor as Predictor, fit_percent as fit_percent
from .reading import read_recording as read_recording
from .recording import Channel as Channel, Recording as Recording
from .results import (
    excitation_text as excitation_text,
    report_data as report_data,
    report_text as report_text,
)
from .robot_variant import variant_text as variant_text, whole_text as whole_text
from .rollout import Rollout as Rollout
from .segments import PreparedRecording as PreparedRecording
from .settings import CalibrationSettings as CalibrationSettings, read_settings as read_settings
from .tables import write_recording as write_recording
