"""How much has to be seen before a thruster or a joint is called faulty."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class ActuatorHealthTuning:
    """Of `ActuatorMonitor`. Raises `InvalidInput` for a number that is not > 0, and a share of 1 or more."""

    sample_time: float = 0.1
    """[s] between two looks at the residual wrench."""
    window: float = 4.0
    """[s] of the residual in which a culprit is looked for, and twice that in which its onset is."""
    force_scale: float = 0.02
    """[-] change of the residual force that counts as one, share of what all thrusters together give on that axis."""
    moment_scale: float = 0.005
    """[-] the same of moments, of which water and loads make less for their force than thrusters do."""
    least_change: float = 1.5
    """[-] root mean square of the changes, in these scales, below which nothing is looked for."""
    explained: float = 0.8
    """[-] share of the changes that the fault of a thruster must explain: in Case 1 without one 0.7 was seen at most, 0.9 for
    a while where the model of the water is wrong by a fifth."""
    lead: float = 4.0
    """[-] times as much as it leaves unexplained must be left by the next best: 2.7 and 9.6 were seen there."""
    precedes: float = 1.25
    """[-] times as much as it leaves unexplained must be left where commands are taken a moment later: commands that only
    answer a push come after it."""
    clear_lead: float = 16.0
    """[-] lead from which on a look counts fully."""
    looks: float = 8.0
    """[-] that must agree, one after the other; those of a smaller lead count by its square."""
    sound_share: float = 0.75
    """[-] of what is asked that a thruster gives at least, else it is weak; less than 0.3 counts as nothing."""
    settling: float = 1.5
    """[s] after a start or a verdict that are not looked at."""
    judged_after: float = 6.0
    """[s] from a verdict to the judgement on what can still be reached, of the wrench that was needed in the second half."""
    jam_travel: float = 0.05
    """[rad or m] that a joint is asked to go, and does not, before it counts as jammed."""
    jam_effort: float = 0.2
    """[-] share of the joint's effort that must resist it."""
    jam_time: float = 0.5
    """[s] for which it stands still all the time."""

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InvalidInput(f"{name} of the actuator health = {value}; give a finite number > 0")
        for name in ("force_scale", "moment_scale", "explained", "sound_share", "jam_effort"):
            if not getattr(self, name) < 1:
                raise InvalidInput(f"{name} of the actuator health = {getattr(self, name)}; give a share below 1")
