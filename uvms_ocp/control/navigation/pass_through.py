"""Readings taken for the truth."""

from __future__ import annotations

import math

import numpy as np

from uvms_ocp.arguments import checked, late, trusted
from uvms_ocp.control.navigation.channels import JOINT_CHANNELS, age_of, needed_channels, oldest_of
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import IDEAL_SENSORS, SensorSpecs
from uvms_ocp.model.state import Command, Measurement, Readings
from uvms_ocp.shown.small_table import SmallTable, Tabled, rows_of

_measurement = trusted(Measurement)


@checked
class PassThrough(Tabled):
    """Takes readings for the truth: for sensors without noise, which it repeats exactly."""

    def __init__(self, robot: Robot, specs: SensorSpecs = IDEAL_SENSORS, altimeter_frame: str | None = None) -> None:
        """altimeter_frame: the one of the robot's description unless given.

        Raises `InvalidInput` where a channel that it needs is missing: it estimates nothing.
        """
        free = robot.n_vehicle > 0
        self.q_channels = (*(("position", "attitude") if free else ()), "joint_positions")
        """Whose readings are q, one after the other."""
        self.v_channels = (*(("linear_velocity", "angular_velocity") if free else ()), "joint_velocities")
        """Whose readings are v."""
        for name in (*self.q_channels, *self.v_channels):
            if getattr(specs, name) is None:
                raise InvalidInput(f"sensor {name} is missing; add it, or use an Estimator instead of PassThrough")
        self._needed = (
            *needed_channels(robot, specs, altimeter_frame or robot.description.altimeter),
            "joint_velocities",
        )

    def _table(self) -> SmallTable:
        told = {"q from": ", ".join(self.q_channels), "v from": ", ".join(self.v_channels)}
        return SmallTable(title=type(self).__name__, rows=rows_of(told))

    @late
    def __call__(self, readings: Readings, t: float, command: Command | None = None) -> Measurement:
        """The last readings at time t [s]; `command` is not read. Raises `InvalidInput` before the first ones."""
        age, oldest = oldest_of(readings, self._needed, t)
        if age == math.inf:
            raise InvalidInput(f"no reading of every channel yet at t = {t} s; use an Estimator for such sensors")
        q = np.concatenate([getattr(readings, name).value for name in self.q_channels])
        v = np.concatenate([getattr(readings, name).value for name in self.v_channels])
        echo = readings.altimeter_range
        return _measurement(
            q=q,
            v=v,
            altimeter_range=math.nan if echo is None else echo.value,
            age=age,
            oldest=oldest,
            joint_age=age_of(readings, JOINT_CHANNELS, t),
        )
