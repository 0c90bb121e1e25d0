"""Which tasks act when: phases, their transitions, and the log of why ([Gao2022] figures 3 and 4).

`Mission` is a value without memory. Its memory is `MissionState`, another value: `Mission.step` maps one to the next.
"""

from uvms_ocp.mission.abort import Abort as Abort
from uvms_ocp.mission.conditions import ABORT as ABORT
from uvms_ocp.mission.conditions import DONE as DONE
from uvms_ocp.mission.conditions import Above as Above
from uvms_ocp.mission.conditions import Below as Below
from uvms_ocp.mission.conditions import Condition as Condition
from uvms_ocp.mission.conditions import Transition as Transition
from uvms_ocp.mission.mission import Mission as Mission
from uvms_ocp.mission.phase import Event as Event
from uvms_ocp.mission.phase import MissionState as MissionState
from uvms_ocp.mission.phase import Phase as Phase
