"""How a load at the tool is learnt, and how far the model is trusted meanwhile."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput

LOAD_FRAME = "tool"
"""Where the load hangs."""


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class LoadLearning:
    """Of `LoadLearner`. Raises `InvalidInput` for a number that is not finite and > 0, and a share above 1."""

    feed_forward: bool = True
    """Whether the learnt weight follows the arm's posture at once, and not as fast as the observer."""
    period: float = 0.1
    """[s] between two looks at the disturbance."""
    settling: float = 1.5
    """[s] after a start, or after a velocity that was not to be trusted, that are not looked at."""
    weight: float = 200.0
    """[N] standard deviation of the net weight before anything is known of it."""
    mass: float = 20.0
    """[kg] the same of the mass."""
    current: float = 0.5
    """[m/s] the same of the current in each direction."""
    current_walk: float = 0.01
    """[m/s] by which the current may change within a second."""
    lasting: float = 0.005
    """[-] force that the model lacks for long on every axis, share of the most that thrusters or motors give there."""
    lasting_time: float = 60.0
    """[s] after which that has become another."""
    unsteady: float = 0.001
    """[-] force, the same share, below which the disturbance is noise at least."""
    alike: float = 2.0
    """[s] for which the disturbance is wrong in the same way: what the model lacks of a motion lasts longer than noise."""
    drag: float = 0.1
    """[-] share of its slope that the drag of a moving tool's velocity may be wrong by."""
    least_acceleration: float = 0.05
    """[m/s2] of the tool, below which nothing is learnt of the mass: noise of the velocity looks the same."""
    surprise: float = 4.0
    """[-] standard deviations, root mean square of all axes, beyond which something else is carried, or the water has changed."""
    scale: float = 0.03
    """[-] to which the forces of thrusters and motors are known: standard errors of weight and mass are no smaller share."""
    mass_share: float = 0.25
    """[-] standard error, share of the mass, at which this is determined."""
    mass_error: float = 0.25
    """[kg] or that at most: a tool that carries nothing has no share."""

    def __post_init__(self) -> None:
        for name in (name for name in self.__slots__ if name != "feed_forward"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InvalidInput(f"{name} of the load learning = {value}; give a finite number > 0")
        for name in ("lasting", "unsteady", "drag", "scale", "mass_share"):
            if getattr(self, name) > 1:
                raise InvalidInput(f"{name} of the load learning = {getattr(self, name)}; give a share of 1 or less")
