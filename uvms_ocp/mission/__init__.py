"""Missions: phases, their transitions, and the log of why they ended ([Gao2022] figures 3 and 4).

`Mission` is a value without memory. Its memory is `MissionState`, another value: `Mission.step` maps one to the next.
"""

from uvms_ocp.mission.mission import Mission as Mission
from uvms_ocp.mission.phase import Abort as Abort
from uvms_ocp.mission.phase import Above as Above
from uvms_ocp.mission.phase import Below as Below
from uvms_ocp.mission.phase import Condition as Condition
from uvms_ocp.mission.phase import Event as Event
from uvms_ocp.mission.phase import MissionState as MissionState
from uvms_ocp.mission.phase import Phase as Phase
from uvms_ocp.mission.phase import Transition as Transition
from uvms_ocp.record.meta_values import ABORT as ABORT
from uvms_ocp.record.meta_values import DONE as DONE
