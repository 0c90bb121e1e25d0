"""What the health monitor takes for possible, with reasons."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class HealthTuning:
    """Tolerances and times. Raises `InvalidInput` for a number that is not finite and > 0.

    A tolerance is added to 8 standard deviations of the channel's noise, which noise passes once in 1e15 readings, and covers
    how wrong an estimate can be of a robot that manoeuvres in gusts.
    """

    chance: float = 1e-9
    """[-] that noise repeats a value, or losses a silence, by themselves; 1e8 readings fit into a hundred hours of gyro."""
    periods_to_suspect: float = 2.5
    """[-] of silence: 0.5 s of a 5 Hz DVL, before a watchdog of 0.6 s holds."""
    periods_to_lose: float = 8.0
    """[-] of silence, or of nothing but refused readings."""
    least_to_suspect: float = 0.05
    """[s] of silence of a quick sensor: as long as joints are fed back without encoders."""
    least_to_lose: float = 0.25
    """[s] of silence of a quick sensor."""
    clean: float = 1.0
    """[s] without complaint after which a channel is good again: five readings of a 5 Hz sensor."""
    clock: float = 0.001
    """[s] by which a time stamp may lie in the future: what clocks that are kept together differ by."""
    late: float = 0.02
    """[s] beyond its delay after which a reading is late: 2 cm at 1 m/s."""
    too_late: float = 2.0
    """[s] beyond its delay after which a reading is not used: half the length of a vehicle at its usual speed."""
    position: float = 0.1
    """[m] of position, depth and floor."""
    position_drift: float = 0.05
    """[m/s] of a position that a DVL carries, or of a depth that anything does: its bias, and the attitude's."""
    attitude: float = 0.05
    """[rad]"""
    attitude_drift: float = 0.02
    """[rad/s] of an attitude that a gyro carries: ten times the noise of the gyro."""
    velocity: float = 0.25
    """[m/s]: a vehicle that accelerates with 1 m/s2 between two readings of a DVL."""
    velocity_drift: float = 0.02
    """[m/s2] of a velocity that position fixes carry."""
    rate: float = 0.2
    """[rad/s] of the vehicle: a blow."""
    rate_drift: float = 0.1
    """[rad/s2] of a rate that attitudes carry."""
    joints: float = 0.05
    """[rad or m] of joint positions."""
    joint_rate: float = 0.5
    """[rad/s or m/s] of joint velocities: a joint that meets its stop."""
    current: float = 1.0
    """[m/s] of water, which moves a vehicle beyond its own velocity limits."""
    slope: float = 3.0
    """[-] of a floor; the steepest way over 1350 lines across floors with large protuberances is 2.8."""
    relief: float = 10.0
    """[m] of the highest step of a floor: nearly twice the highest of large protuberances."""
    step_time: float = 2.0
    """[s] for which echoes from a floor that is farther away agree before they are believed: twenty of a 10 Hz altimeter."""
    step_travel: float = 0.2
    """[m] of vertical motion in that time, which a value that is stuck does not follow; ten times the noise."""
    step_way: float = 0.3
    """[m] of horizontal motion after which there may be another floor."""
    floor_memory: float = 60.0
    """[s] for which an echo tells of the floor where it was taken."""
    encoder_travel: float = 0.02
    """[rad or m] that is asked of a joint while its encoder does not change by a bit."""
    gyro_alone: float = 10.0
    """[s] for which a gyro stands in for the attitude: 0.01 rad at a drift of 1e-3 rad/s."""

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InvalidInput(f"{name} of the health monitor = {value}; give a finite number > 0")
        if not self.chance < 1:
            raise InvalidInput(f"chance of the health monitor = {self.chance}; give a probability below 1")
