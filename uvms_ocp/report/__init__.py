"""Figures of merit of one run, read from its `Record` alone, and of two runs side by side."""

from uvms_ocp.report.cause import cause_of_end as cause_of_end
from uvms_ocp.report.compare import compare as compare
from uvms_ocp.report.ocp_motion import ocp_record as ocp_record
from uvms_ocp.report.ocp_motion import ocp_report as ocp_report
from uvms_ocp.report.planned_motion import motion_record as motion_record
from uvms_ocp.report.planned_motion import plan_report as plan_report
from uvms_ocp.report.resources import resources as resources
from uvms_ocp.report.sensor_health import sensor_health as sensor_health
from uvms_ocp.report.series import max_velocity_step as max_velocity_step
from uvms_ocp.report.series import quantity as quantity
from uvms_ocp.report.summary import phase_table as phase_table
from uvms_ocp.report.summary import summarize as summarize
from uvms_ocp.report.transitions import transition_series as transition_series
from uvms_ocp.report.transitions import transition_table as transition_table
