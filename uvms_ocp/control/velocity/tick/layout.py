"""The memory of one tick of the kinematic layer: where the mission is, what is known, and what comes of it."""

from __future__ import annotations

from typing import Annotated

from uvms_ocp.control.navigation.degraded import RestrictionMemory
from uvms_ocp.control.navigation.last_known import EchoMemory, SoundMemory
from uvms_ocp.control.velocity.climb import ClimbMemory
from uvms_ocp.control.velocity.distress import DistressMemory
from uvms_ocp.control.velocity.nearest import NearestMemory
from uvms_ocp.control.velocity.parameters import GoalsMemory
from uvms_ocp.control.velocity.restraint import RestraintMemory
from uvms_ocp.control.velocity.viability import RuleMemory
from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector
from uvms_ocp.mission.progress import MissionMemory


class TickMemory(Layout):
    """All that a tick reads and remembers."""

    mission: MissionMemory
    """Where it is."""
    distress: DistressMemory
    """Whether it is to be given up."""
    rule: RuleMemory
    """Limits on positions."""
    restriction: RestrictionMemory
    """What is not done because of channels that cannot be trusted."""
    restraint: RestraintMemory
    """What is left of a velocity."""
    sound: SoundMemory
    """What stands in for a measurement that is not sound."""
    beam: EchoMemory
    """Where the altimeter looks."""
    climb: ClimbMemory
    """Where the abort phase leads to."""
    goals: GoalsMemory
    """Parameters of the tasks, an input of the levels."""
    nearest: NearestMemory
    """Distances among them."""

    velocity_limit: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s]"""
    reads_altitude: Annotated[list[int], Sized("n_tasks")]
    """(n_tasks,) which tasks read the altimeter."""
    lands: Annotated[list[int], Sized("n_tasks")]
    """(n_tasks,) which of them ask for one altitude."""
    rest_altitude: Annotated[Vector, Sized("n_tasks")]
    """(n_tasks,) [m] as that of `Task`."""
    rests_on: Annotated[list[list[int]], Sized("n_channels", "n_quantities")]
    """(n_channels, n_quantities) as that of `LevelsProblem`."""
    channel: Annotated[list[int], Sized("n_channels")]
    """(n_channels,) each of these among all `CHANNELS`."""
    altimeter: int
    """Among these channels."""
    hold_after: float
    """[s] as those of `Watchdog`."""
    stop_after: float
    """[s]"""

    t: float
    """[s] time of the tick."""
    q: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] measured; where that is not sound, the last that was, and so the next three."""
    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] of the same."""
    altimeter_range: float
    """[m] NaN without an echo."""
    age: float
    """[s] as those of `Measurement`."""
    joint_age: float
    """[s]"""

    # found by `before`, inputs of the levels among it
    gates: Annotated[Vector, Sized("n_tasks")]
    """(n_tasks,) [-] external activations."""
    altitude_matters: bool
    """A task that is on reads the altimeter."""
    echo: Annotated[Vector, Sized(1)]
    """(1,) [m] range that tasks act on."""
    altitude_known: bool
    """As that of `TickState`."""
    echo_is_oldest: bool
    """Of all that is needed."""
    oldest: float
    """[s] age of what is."""
    freshness: int
    """A `Freshness`."""
    holds: bool
    """The robot comes to rest, whatever the tasks want."""
    previous: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] commanded in the last tick, at full pace."""
    change: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] of that since the tick before it: a change of pace is none of the hierarchy's, and not to be eased."""

    # of the hierarchy
    solved: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] that the hierarchy asks for."""
    usable: bool
    """Whether it does."""
    quantities: Annotated[Vector, Sized("n_quantities")]
    """(n_quantities,) [their units] of the levels."""

    # found by `after`
    reported: Annotated[Vector, Sized("n_quantities")]
    """(n_quantities,) [their units] NaN where not known."""
    told: Annotated[Vector, Sized("n_quantities")]
    """(n_quantities,) [their units] what phases may end on."""
    last_told: Annotated[Vector, Sized("n_quantities")]
    """(n_quantities,) [their units] the same of the last tick that did not hold."""
    why: int
    """A `Why`."""
    due: int
    """The transition of the phase that fires, or `NONE`."""
    eventful: bool
    """The mission is to be looked at."""
    jammed: Annotated[list[int], Sized("n_v")]
    """(n_v,) axes that do not move whatever is asked."""
    wanted: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] the velocity for this tick."""
    wanted_pace: float
    """[-] in (0, 1], that it is at of what the hierarchy has."""
    near: bool
    """A stop from it could come to a limit on positions."""
    share: float
    """[-] of it that the limits on positions leave; 0 where the robot comes to rest."""

    # the motion of the last tick
    place: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] as far as it is known: measured, or along the stop since."""
    command: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] the last velocity that was taken."""
    pace: float
    """[-] that it was at."""
