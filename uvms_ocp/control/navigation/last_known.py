"""What stands in for a measurement that is missing: the last one, older by the time since."""

from __future__ import annotations

import math

import numpy as np

from uvms_ocp.arguments import changed
from uvms_ocp.model.kinematics import STEEP, AltimeterBeam, Beam
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import Measurement

_SLOPE = 0.3  # [-] of a floor that nobody sees: it rises by so much of the way
_FORGETTING = 0.05  # [m/s] with which the highest floor sinks to the present one
_LEVEL = 1e-6  # cosine of a tilt; a beam nearer to the horizon has no range that stands for a height


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
            oldest=measurement.oldest,
            joint_age=max(measurement.joint_age, self._last.joint_age + late),
            health=measurement.health,
        )


class LastEcho:
    """How high the altimeter is above the floor: by its echo, or by the last one, carried along with the measured motion.

    Carrying takes the floor for level, except in doubt: then it is the highest of late, as the echoes may have lied for some
    time, and rises with the way. An echo along a beam that does not look down tells no height.
    """

    __slots__ = ("_beam", "_floor", "_place", "highest", "since")

    def __init__(self, robot: Robot, frame: str | None) -> None:
        """frame: that of the altimeter; `None` or one that the robot does not have: no altitude is ever known."""
        self._beam = None if frame is None or not robot.has_frame(frame) else AltimeterBeam(robot, frame)
        self._floor = math.nan
        """[m] z of the floor below the last echo in W."""
        self.highest = math.nan
        """[m] z of the floor in W, the highest of late; NaN before the first echo."""
        self._place = np.zeros(2)
        """(2,) [m] of the last look in W."""
        self.since = 0.0
        """[s] time of the last echo, 0 before the first."""

    def range(self, measurement: Measurement, t: float, unknown: float, doubted: bool = False) -> float:
        """[m], always finite, at the tick at time t [s]; `unknown` [m] is the altitude to act on before the first echo.

        doubted: no echo of now is to be believed.
        """
        beam, echo = self._look(measurement)
        if doubted and beam is not None:
            self.highest += _SLOPE * math.dist(self._place, beam.origin[:2])
            self._floor, self._place = self.highest, beam.origin[:2]
        if doubted or beam is None or echo is None:
            return self._carried(beam, unknown)
        floor, faded = float(beam.origin[2]) - beam.cosine * echo, self.highest - _FORGETTING * (t - self.since)
        self.since, self._floor, self._place = t, floor, beam.origin[:2]
        self.highest = max(floor, faded) if math.isfinite(faded) else floor
        return echo

    def at(self, measurement: Measurement) -> tuple[float, bool]:
        """Range [m], always finite, at a measurement that is not remembered, and whether its echo tells the altitude."""
        beam, echo = self._look(measurement)
        return (self._carried(beam, 0.0), False) if echo is None else (echo, True)

    def known(self, t: float, patience: float) -> bool:
        """Whether the altitude at time t [s] rests on an echo that is no older than `patience` [s]."""
        return math.isfinite(self._floor) and t - self.since <= patience

    def _look(self, measurement: Measurement) -> tuple[Beam | None, float | None]:
        """Where the altimeter looks, and its echo [m] if that tells an altitude."""
        if self._beam is None:
            return None, None
        beam, echo = self._beam.at(measurement.q), measurement.altimeter_range
        return beam, echo if math.isfinite(echo) and beam.cosine > STEEP else None

    def _carried(self, beam: Beam | None, unknown: float) -> float:
        if beam is None:
            return 0.0
        height = max(0.0, float(beam.origin[2]) - self._floor) if math.isfinite(self._floor) else unknown
        return height / math.copysign(max(abs(beam.cosine), _LEVEL), beam.cosine)
