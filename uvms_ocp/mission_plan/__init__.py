"""Plans of whole missions: phases, thresholds and limits as one problem over one horizon."""

from uvms_ocp.mission_plan.mission_plan import MissionPlan as MissionPlan
from uvms_ocp.mission_plan.planner import plan_mission as plan_mission
from uvms_ocp.mission_plan.segments import Margins as Margins
