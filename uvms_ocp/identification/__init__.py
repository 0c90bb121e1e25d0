"""Identify the numbers of a vehicle from its own recordings.

Data flows one way: recordings (`reading`, `data_quality`) -> `parameters` (physically consistent at any value) -> `model` (one
step of the vehicle, from the symbolic dynamics) -> `output_error` (the fit) -> `uncertainty`, `validation` -> `results`.
`experiment_design` goes the other way: from numbers to be identified to commands that excite them.
"""

from uvms_ocp.identification.calibration import Calibration as Calibration
from uvms_ocp.identification.calibration import calibrate as calibrate
from uvms_ocp.identification.data_quality import check_data_quality as check_data_quality
from uvms_ocp.identification.experiment import ExperimentLimits as ExperimentLimits
from uvms_ocp.identification.experiment_design import DesignSettings as DesignSettings
from uvms_ocp.identification.experiment_design import ExperimentTask as ExperimentTask
from uvms_ocp.identification.experiment_design import design_experiment as design_experiment
from uvms_ocp.identification.fit import Predictor as Predictor
from uvms_ocp.identification.fit import fit_percent as fit_percent
from uvms_ocp.identification.model import Vehicle as Vehicle
from uvms_ocp.identification.model import stage_of as stage_of
from uvms_ocp.identification.output_error import Noise as Noise
from uvms_ocp.identification.parameters import AXES as AXES
from uvms_ocp.identification.reading import RecordingMapping as RecordingMapping
from uvms_ocp.identification.reading import mapped_recording as mapped_recording
from uvms_ocp.identification.reading import read_mapping as read_mapping
from uvms_ocp.identification.reading import read_recording as read_recording
from uvms_ocp.identification.recording import Channel as Channel
from uvms_ocp.identification.recording import Recording as Recording
from uvms_ocp.identification.results import excitation_text as excitation_text
from uvms_ocp.identification.results import report_text as report_text
from uvms_ocp.identification.results import variant_text as variant_text
from uvms_ocp.identification.results import whole_text as whole_text
from uvms_ocp.identification.rollout import PreparedRecording as PreparedRecording
from uvms_ocp.identification.rollout import Rollout as Rollout
from uvms_ocp.identification.settings import CalibratedRobot as CalibratedRobot
from uvms_ocp.identification.settings import CalibrationSettings as CalibrationSettings
from uvms_ocp.identification.settings import calibrated_robot as calibrated_robot
from uvms_ocp.identification.settings import read_settings as read_settings
from uvms_ocp.identification.tables import write_recording as write_recording
from uvms_ocp.identification.uncertainty import IdentifiedNumber as IdentifiedNumber
from uvms_ocp.identification.uncertainty import values_of as values_of
