from .mission import ABORT as ABORT, DONE as DONE, Mission as Mission
from .phase import (
    Abort as Abort,
    Above as Above,
    Below as Below,
    Condition as Condition,
    Event as Event,
    MissionState as MissionState,
    Phase as Phase,
    Transition as Transition,
)
