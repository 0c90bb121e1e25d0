"""What stands in for a measurement that is missing: the last one, older by the time since."""

from __future__ import annotations

import math
from typing import Annotated, Any

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import Shape, changed
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.functions.buffered import BoundFunction
from uvms_ocp.functions.compile import compile_function
from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector, structure_of, view
from uvms_ocp.model.kinematics import STEEP
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import Measurement
from uvms_ocp.model.symbolic.tree import SymbolicModel

_SLOPE = 0.3  # [-] of a floor that nobody sees: it rises by so much of the way
_FORGETTING = 0.05  # [m/s] with which the highest floor sinks to the present one
_UNIT = 1e-3  # by which the norm of a quaternion may differ from 1, as in records
_LEVEL = 1e-6  # cosine of a tilt; a beam nearer to the horizon has no range that stands for a height


class LastSound:
    """The measurement, or where its q or v is not finite or its quaternion none, the last that was sound, with its true age."""

    __slots__ = ("_last", "_model", "_no_q", "_no_v", "_since")

    def __init__(self, robot: Robot) -> None:
        rest = Measurement(q=robot.configuration(), v=np.zeros(robot.n_v), altimeter_range=np.nan)
        self._last, self._since = rest, -np.inf
        self._model = robot.model
        self._no_q, self._no_v = np.zeros(robot.n_q), np.zeros(robot.n_v)

    def __call__(self, measurement: Measurement, t: float) -> Measurement:
        """t [s]: time of the tick. Raises `InvalidInput` for a q or v of another robot's size."""
        if measurement.q.shape != self._no_q.shape or measurement.v.shape != self._no_v.shape:
            raise InvalidInput(self._misfit(measurement))
        if self._is_sound(measurement):
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

    def _is_sound(self, measurement: Measurement) -> bool:
        q = measurement.q
        # 0 times what is not finite is NaN; a third of the time of a look at each.
        finite = q.dot(self._no_q) == 0.0 and measurement.v.dot(self._no_v) == 0.0
        return bool(finite and pin.isNormalized(self._model, q, _UNIT))

    def _misfit(self, measurement: Measurement) -> str:
        pairs = (("q", measurement.q, self._no_q), ("v", measurement.v, self._no_v))
        wrong = [(name, value.shape, right.shape) for name, value, right in pairs if value.shape != right.shape]
        return ", ".join(f"measurement.{name} has shape {shape}; give {right}" for name, shape, right in wrong)


class EchoMemory(Layout):
    """What `LastEcho` knows, and where the altimeter looks: along -z of its frame."""

    exists: bool
    """There is an altimeter."""
    beam: Annotated[Vector, Sized(4)]
    """(4,) [m] origin in W, and [-] cosine of the angle between the beam and straight down."""
    climb: Annotated[Vector, Sized("n_v")]
    """(n_v,) [-, m] rise of the origin per unit of each velocity."""
    floor: float
    """[m] z in W of the floor below the last echo; NaN before the first."""
    highest: float
    """[m] the same, the highest of late."""
    place: Annotated[Vector, Sized(2)]
    """(2,) [m] in W of the last look."""
    since: float
    """[s] time of the last echo, 0 before the first."""


def echo_range(m: EchoMemory, t: float, echo: float, unknown: float, doubted: bool) -> float:
    """As `LastEcho.range` at t [s], of the echo [m] along the beam that the memory holds, or `unknown` [m]. A kernel."""
    if doubted and m.exists:
        x, y = m.beam[0] - m.place[0], m.beam[1] - m.place[1]
        m.highest += _SLOPE * math.sqrt(x * x + y * y)
        m.floor = m.highest
        m.place[0] = m.beam[0]
        m.place[1] = m.beam[1]
    if doubted or not tells_altitude(m, echo):
        return carried(m, unknown)
    floor = m.beam[2] - m.beam[3] * echo
    faded = m.highest - _FORGETTING * (t - m.since)
    m.since = t
    m.floor = floor
    m.place[0] = m.beam[0]
    m.place[1] = m.beam[1]
    m.highest = max(floor, faded) if math.isfinite(faded) else floor
    return echo


def tells_altitude(m: EchoMemory, echo: float) -> bool:
    """Whether an echo [m] along the beam stands for a height. A kernel."""
    return m.exists and math.isfinite(echo) and m.beam[3] > STEEP


def carried(m: EchoMemory, unknown: float) -> float:
    """Range [m] to the floor of the last echo; before the first one, to an altitude of `unknown` [m]. A kernel."""
    if not m.exists:
        return 0.0
    height = max(0.0, m.beam[2] - m.floor) if math.isfinite(m.floor) else unknown
    return height / math.copysign(max(abs(m.beam[3]), _LEVEL), m.beam[3])


class LastEcho:
    """How high the altimeter is above the floor: by its echo, or by the last one, carried along with the measured motion.

    Carrying takes the floor for level, except in doubt: then it is the highest of late, as the echoes may have lied for some
    time, and rises with the way. An echo along a beam that does not look down tells no height.
    """

    __slots__ = ("_look", "_q", "memory")

    def __init__(
        self, robot: Robot, frame: str | None, memory: Any = None, q: Annotated[np.ndarray, Shape("n_q")] | None = None
    ) -> None:
        """frame: that of the altimeter; `None` or one that the robot does not have: no altitude is ever known.

        memory: an `EchoMemory` of the caller's, who asks `look` where the altimeter looks at `q` (n_q,) [m, rad], its own too.
        """
        self.memory: Any = structure_of(EchoMemory, n_v=robot.n_v)() if memory is None else memory
        """The `EchoMemory`."""
        self.memory.exists = frame is not None and robot.has_frame(frame)
        self.memory.floor = self.memory.highest = math.nan
        self._q, results = np.zeros(robot.n_q) if q is None else q, (view(self.memory.beam), view(self.memory.climb))
        beam = compile_function(_beam(robot, frame)) if self.memory.exists else None
        self._look = None if beam is None else BoundFunction(beam, (self._q,), results)

    @property
    def highest(self) -> float:
        """[m] z of the floor in W, the highest of late; NaN before the first echo."""
        return float(self.memory.highest)

    @property
    def since(self) -> float:
        """[s] time of the last echo, 0 before the first."""
        return float(self.memory.since)

    def look(self) -> None:
        """Where the altimeter looks, into the memory."""
        if self._look is not None:
            self._look.evaluate()

    def range(self, measurement: Measurement, t: float, unknown: float, doubted: bool = False) -> float:
        """[m], always finite, at the tick at time t [s]; `unknown` [m] is the altitude to act on before the first echo.

        doubted: no echo of now is to be believed.
        """
        self._q[:] = measurement.q
        self.look()
        return echo_range(self.memory, t, measurement.altimeter_range, unknown, doubted)

    def at(self, measurement: Measurement) -> tuple[float, bool]:
        """Range [m], always finite, at a measurement that is not remembered, and whether its echo tells the altitude."""
        self._q[:] = measurement.q
        self.look()
        tells = tells_altitude(self.memory, measurement.altimeter_range)
        return (measurement.altimeter_range, True) if tells else (carried(self.memory, 0.0), False)


def _beam(robot: Robot, frame: str | None) -> ca.Function:
    """q -> origin (3,) [m] and cosine [-] of the beam, and how the origin rises with each velocity (n_v,) [m, or 1]."""
    q = ca.SX.sym("q", robot.n_q)
    kinematics = SymbolicModel(robot.model).forward_kinematics(q)
    R_WS, p_WS = kinematics.pose(frame or "")
    outputs = [ca.densify(ca.vertcat(p_WS, R_WS[2, 2])), ca.densify(kinematics.jacobian(frame or "")[2, :].T)]
    return ca.Function("beam", [q], outputs, ["q"], ["beam", "climb"], {"cse": True})
