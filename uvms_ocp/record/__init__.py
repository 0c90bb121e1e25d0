"""One run or plan as data, readable without a robot: series, metadata, files in and out."""

from uvms_ocp.record.output import FolderClaim as FolderClaim
from uvms_ocp.record.output import claim_folder as claim_folder
from uvms_ocp.record.output import recover_folder as recover_folder
from uvms_ocp.record.record import Record as Record
from uvms_ocp.record.record import quantity as quantity
