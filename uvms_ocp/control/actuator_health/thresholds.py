"""How much has to be seen before a thruster or a joint is called faulty."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class HealthTuning:
    """Of `ActuatorMonitor`. Raises `InvalidInput` for a number that is not > 0, and a noise or share of 1 or more.

    Gains are twice the logarithm of a likelihood ratio: squares of standard deviations.
    """

    sample_time: float = 0.1
    """[s] between two looks at the residual wrench."""
    disturbance_memory: float = 0.15
    """[s] after which a change of the residual is forgotten: what is slower is water, not a fault."""
    noise_floor: float = 0.002
    """[-] least standard deviation of a change of the residual, share of what all thrusters together give."""
    model_error: float = 0.15
    """[-] of every change of thrust that wrong masses and drag may turn into residual."""
    noise_memory: float = 10.0
    """[s] over which the standard deviation is learned."""
    correlation: float = 3.0
    """[-] looks that tell no more than one: the residual is smooth."""
    suspect_gain: float = 9.0
    """[-] from which a thruster is suspect."""
    misfit: float = 4.0
    """[-] of what is left unexplained, in variances: more is water, contact or a load, not the fault of one thruster."""
    probe_share: float = 0.1
    """[-] amplitude of the probe, share of the limits of the thrusters."""
    probe_period: float = 0.6
    """[s]"""
    probe_cycles: int = 4
    """[-] that are looked at before the first answer; one comes before."""
    probe_longest: int = 12
    """[-] that are looked at before the probe is given up."""
    rest: float = 6.0
    """[s] after a probe that has found nothing, before the next of the same thrusters."""
    sure: float = 0.12
    """[-] standard deviation of a share at which a probe that has found nothing ends."""
    fault_gain: float = 36.0
    """[-] of a probe that names a fault, against that of sound thrusters."""
    margin: float = 9.0
    """[-] by which the fault that is named leads all others."""
    unprobed_gain: float = 150.0
    """[-] that names a fault where thrusters cannot be probed, as no others cancel their wrench."""
    sound_share: float = 0.75
    """[-] of what is asked that a thruster gives at least, else it is weak; less than a quarter counts as nothing."""
    settling: float = 1.5
    """[s] after a start or a verdict that are not looked at."""
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
        for name in ("noise_floor", "model_error", "probe_share", "sound_share", "jam_effort"):
            if not getattr(self, name) < 1:
                raise InvalidInput(f"{name} of the actuator health = {getattr(self, name)}; give a share below 1")
