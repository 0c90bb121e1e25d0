"""Metrics and reports of one run, read from its `Record` alone, of two runs side by side, and of plans."""

from uvms_ocp.record.record import quantity as quantity
from uvms_ocp.report.comparison import compare as compare
from uvms_ocp.report.comparison import transition_series as transition_series
from uvms_ocp.report.comparison import transition_table as transition_table
from uvms_ocp.report.metrics import max_velocity_step as max_velocity_step
from uvms_ocp.report.metrics import resources as resources
from uvms_ocp.report.planned_motion import motion_record as motion_record
from uvms_ocp.report.planned_motion import ocp_record as ocp_record
from uvms_ocp.report.planned_motion import ocp_report as ocp_report
from uvms_ocp.report.planned_motion import plan_report as plan_report
from uvms_ocp.report.summary import cause_of_end as cause_of_end
from uvms_ocp.report.summary import phase_table as phase_table
from uvms_ocp.report.summary import sensor_health as sensor_health
from uvms_ocp.report.summary import summarize as summarize
