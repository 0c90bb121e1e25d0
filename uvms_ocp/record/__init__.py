"""One run or plan as data, readable without a robot: series, metadata, files in and out."""

from uvms_ocp.record.record import Record as Record, quantity as quantity
