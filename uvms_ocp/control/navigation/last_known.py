"""What stands in for a measurement that is missing: the last one, older by the time since."""

from __future__ import annotations

import numpy as np

from uvms_ocp.arguments import changed
from uvms_ocp.model.kinematics import STEEP, AltimeterBeam
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import Measurement

NO_ECHO_RANGE = 100.0
"""[m] stands in for the altimeter's range before the first echo."""


class LastSound:
    """The measurement, or where its q or v is not finite, the last that was finite, with its true age."""

    __slots__ = ("_last", "_since")

    def __init__(self, robot: Robot) -> None:
        rest = Measurement(q=robot.configuration(), v=np.zeros(robot.n_v), altimeter_range=np.nan)
        self._last, self._since = rest, -np.inf

    def __call__(self, measurement: Measurement, t: float) -> Measurement:
        """t [s]: time of the tick."""
        if np.isfinite(measurement.q).all() and np.isfinite(measurement.v).all():
            self._last, self._since = measurement, t
            return measurement
        late = t - self._since
        return changed(
            self._last,
            altimeter_range=measurement.altimeter_range,
            age=max(measurement.age, self._last.age + late),
            joint_age=max(measurement.joint_age, self._last.joint_age + late),
        )


class LastEcho:
    """The range of the altimeter; without an echo the last one, carried along with the measured motion.

    That takes the floor for level. A robot without an altimeter has `NO_ECHO_RANGE`.
    """

    __slots__ = ("_beam", "_height", "_range", "since")

    def __init__(self, robot: Robot) -> None:
        frame = robot.description.altimeter
        self._beam = None if frame is None or not robot.has_frame(frame) else AltimeterBeam(robot, frame)
        self._range = NO_ECHO_RANGE
        """[m] of the last echo."""
        self._height = np.nan
        """[m] z of the floor below it in W."""
        self.since = 0.0
        """[s] time of the last echo, 0 before the first."""

    def range(self, measurement: Measurement, t: float) -> float:
        """[m] at the tick at time t [s]."""
        echo = measurement.altimeter_range
        if np.isfinite(echo):
            self.since, self._range = t, echo
            if self._beam is not None:
                beam = self._beam.at(measurement.q)
                self._height = float(beam.origin[2]) - beam.cosine * echo
            return echo
        return self.carried(measurement.q)

    def carried(self, q: np.ndarray) -> float:
        """[m] at q (n_q,) [m, rad], from the last echo."""
        if self._beam is None or not np.isfinite(self._height):
            return self._range
        beam = self._beam.at(q)
        return max(0.0, float(beam.origin[2]) - self._height) / max(beam.cosine, STEEP)
