"""A whole mission as one problem: its phases, thresholds and limits over one horizon, and the plan that is flown by them."""

from uvms_ocp.mission_plan.margins import Margins as Margins
from uvms_ocp.mission_plan.mission_plan import MissionPlan as MissionPlan
from uvms_ocp.mission_plan.planning import plan_mission as plan_mission
