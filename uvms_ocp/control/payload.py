"""Payload at the tool: its generalized force, and its estimate from the disturbance observer by an
extended Kalman filter.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from uvms_ocp.codegen import BufferedFunction, compile_function
from uvms_ocp.control.load_filter import (
    LOAD_FRAME,
    LoadFilter,
    LoadLearning,
    LoadSample,
    require_limits,
)
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import size, symbolic_bodies, thrusters
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics

COLUMNS = 5
"""Columns of `response_function` beside the two of each tool."""
# [m/s] of drag's slope: that of quadratic drag vanishes in still water, where no step would be the
# right one; a current, which is the sea's and the same for any robot
_LEAST_FLOW = 0.1

_MASS_SHARE = 0.25  # standard error of the mass, share of it, at which this is determined
# or share of the mass of the heaviest load, at most: a tool that carries nothing has no share
_LEAST_MASS_ERROR = 0.0125
_HEAVE = thrusters.AXES.index("heave")
_CERTAIN = 3.0  # standard errors that a weight must have to be carried along


def require_learnable(robot: Robot, *, observed: bool) -> None:
    """Raise `FrameNotFound` for a robot without a tool, and `InvalidInput` where it may not learn.

    That is where an axis bears no force or any, and where the disturbance is not observed.
    """
    if not observed:
        raise InvalidInput(
            "a load is learnt from the disturbance observer; give it a bandwidth, or load=None"
        )
    robot.frame_id(LOAD_FRAME)
    require_limits(thrusters.largest_force(robot))


def heaviest_load(robot: Robot) -> float:
    """Return the weight [N] of a load that a robot may carry: what thrusters lift, or where none do
    its own weight.
    """
    lift = 0.0
    if robot.n_vehicle:
        lift = float(thrusters.largest_force(robot)[_HEAVE])
    return lift or size.weight(robot.model)


# What a load at the tool, and a current, add to the generalized force that an observer takes for a
# disturbance.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ForceResponse:
    """Response of an observer to k forces, each as if it were the only disturbance."""

    estimate: ca.SX
    """(n_v, k) [N, N m] change of its estimate."""
    innovation: ca.SX
    """(n_v, k) [m/s, rad/s] change of its innovation."""


ObserverResponse = Callable[[ForceResponse, ca.SX, ca.SX, ca.SX], ForceResponse]
"""Law by which a response goes on for a tick, from the mass matrix, forces (n_v, k) [N, N m] and
shares (n_v,) of the bandwidth: `ObserverLaw.response`.
"""


def load_force(
    body: SymbolicDynamics, q: ca.SX, acceleration: ca.SX, tool: str = LOAD_FRAME
) -> ca.SX:
    """Return the generalized force (n_v, 2) of 1 N of net weight, and of 1 kg, at q (n_q,) [m,
    rad].

    acceleration (3,) [m/s2] of the tool, a frame, in W. A point load of mass m and volume V gives
    ``J.T (W down - m a)`` with the net weight ``W = (m - rho V) g``: what it has of its mass alone
    shows only where the tool accelerates.
    """
    J = body.symbolic.forward_kinematics(q).jacobian(tool)[:3, :]
    gravity = symbolic_bodies.sparse(body.model.gravity.linear)
    return ca.horzcat(J.T @ (gravity / ca.norm_2(gravity)), -J.T @ acceleration)


def current_force(body: SymbolicDynamics, q: ca.SX, v: ca.SX, current: ca.SX) -> ca.SX:
    """Return the generalized force (n_v, 4) of the currents u near `current` (3,) [m/s] in W: the
    first column plus the others times u.

    At q (n_q,) [m, rad] and v (n_v,) [m/s, rad/s].
    """
    n = len(body.links)
    still = ca.SX(3, n)
    flow = ca.SX.sym("flow", 3)
    force_in_flow = body.bias_force(q, v, ca.repmat(flow, 1, n), still)
    drag = body.bias_force(q, v, still, still) - force_in_flow
    quicker = current + ca.if_else(current < 0, -_LEAST_FLOW, _LEAST_FLOW)
    slopes = ca.substitute(ca.jacobian(drag, flow), flow, quicker)
    return ca.horzcat(ca.substitute(drag, flow, current) - slopes @ current, slopes)


def tool_function(body: SymbolicDynamics, tools: Sequence[str] = (LOAD_FRAME,)) -> ca.Function:
    """Build the function ``q, v -> weight, velocity``: `load_force` of 1 N, and the velocity [m/s]
    in W, a column for each of the tools.
    """
    q = ca.SX.sym("q", body.model.nq)
    v = ca.SX.sym("v", body.model.nv)
    kinematics = body.symbolic.forward_kinematics(q)
    velocity = ca.horzcat(*(kinematics.jacobian(tool)[:3, :] @ v for tool in tools))
    weight = ca.horzcat(*(load_force(body, q, ca.SX(3, 1), tool)[:, 0] for tool in tools))
    return ca.Function(
        "tool", [q, v], [ca.densify(weight), velocity], ["q", "v"], ["weight", "velocity"]
    )


def response_function(
    body: SymbolicDynamics, response: ObserverResponse, tools: Sequence[str] = (LOAD_FRAME,)
) -> ca.Function:
    """Build the function ``q, v, acceleration, current, share, estimate, innovation -> estimate,
    innovation``.

    The response of the observer to what is put into its estimate and bears no force, to
    `load_force` of each of the tools, whose acceleration is (3, n_tools), and to `current_force`.
    """
    n = body.model.nv
    n_columns = COLUMNS + 2 * len(tools)
    q = ca.SX.sym("q", body.model.nq)
    v = ca.SX.sym("v", n)
    acceleration = ca.SX.sym("acceleration", 3, len(tools))
    current = ca.SX.sym("current", 3)
    share = ca.SX.sym("share", n)
    before = ForceResponse(
        estimate=ca.SX.sym("estimate", n, n_columns),
        innovation=ca.SX.sym("innovation", n, n_columns),
    )
    drag = current_force(body, q, v, current)
    loads = [load_force(body, q, acceleration[:, k], tool) for k, tool in enumerate(tools)]
    force = ca.horzcat(ca.SX(n, 1), *loads, drag)
    after = response(before, body.mass_matrix(q), force, share)
    inputs = [q, v, acceleration, current, share, before.estimate, before.innovation]
    outputs = ca.cse([ca.densify(after.estimate), ca.densify(after.innovation)])
    return ca.Function("response", inputs, outputs)


@dataclass(frozen=True, kw_only=True, slots=True)
class LoadEstimate:
    """Forces of a point load at the tool."""

    weight: float
    """[N] net weight in water, downwards."""
    weight_error: float
    """[N] standard error of the weight."""
    mass: float
    """[kg] NaN while it is undetermined."""
    mass_error: float
    """[kg] standard error of the mass."""


@lru_cache(maxsize=8)
def load_functions(
    body: SymbolicDynamics, response: ObserverResponse, tools: tuple[str, ...]
) -> tuple[ca.Function, ca.Function]:
    """Make `tool_function` and `response_function` for a learner, once; compiled where there is a
    compiler.
    """
    tool = compile_function(tool_function(body, tools))
    return tool, compile_function(response_function(body, response, tools))


class LoadLearner:
    """Learns from an observer's estimate. Holds what it knows: build one per run.

    Around each tick of the observer it is called twice: `carry` before, `learn` after it.
    """

    def __init__(
        self,
        body: SymbolicDynamics,
        response: ObserverResponse,
        settings: LoadLearning,
        *,
        tools: tuple[str, ...] = (LOAD_FRAME,),
        limit: np.ndarray,
        bandwidth: np.ndarray,
        heaviest: float,
        dt: float,
    ) -> None:
        """limit (n_v,) [N, N m] and bandwidth (n_v,) [rad/s] of the observer of the `body`, dt [s]
        its period; tools: frames; heaviest [N]: `heaviest_load` of the robot.
        """
        tool, observer_response = load_functions(body, response, tools)
        self._tool = BufferedFunction(tool)
        self._response = BufferedFunction(observer_response)
        self._every = max(1, round(settings.period / dt))
        self._settling = round(settings.settling / dt)
        self._settings = settings
        self._dt = dt
        self._limit = limit
        n = len(limit)
        n_tools = len(tools)
        # Samples are whole ticks apart.
        filter_settings = replace(settings, period=self._every * dt)
        self.filter = LoadFilter(filter_settings, limit, bandwidth, n_tools, heaviest=heaviest)
        """Filter of the loads."""
        gravity = float(np.linalg.norm(body.model.gravity.linear))
        self._least_mass_error = _LEAST_MASS_ERROR * heaviest / gravity  # [kg]
        self._estimate = np.zeros((n, COLUMNS + 2 * n_tools))
        self._innovation = np.zeros((n, COLUMNS + 2 * n_tools))
        self._weight = np.zeros((n, n_tools))
        self._velocity = np.zeros((3, n_tools))
        self._acceleration = np.zeros((3, n_tools))
        self._ticks = 0
        self._free = np.ones(n, dtype=bool)

    @property
    def loads(self) -> tuple[LoadEstimate, ...]:
        """Return the load at each tool, as far as it is known."""
        return tuple(self._load(2 * k) for k in range(self._weight.shape[1]))

    def _load(self, place: int) -> LoadEstimate:
        weight, mass = self.filter.x[place : place + 2].tolist()
        weight_error = self.filter.error(place)
        error = self.filter.error(place + 1)
        is_accurate = error <= max(self._least_mass_error, _MASS_SHARE * abs(mass))
        return LoadEstimate(
            weight=weight,
            weight_error=weight_error,
            mass=mass if is_accurate else np.nan,
            mass_error=error,
        )

    def leave(self, jammed: Sequence[int]) -> None:
        """Leave axes of v out that do not move, and tell nothing."""
        self._free[list(jammed)] = False

    def carry(self, q: np.ndarray, v: np.ndarray, estimate: np.ndarray) -> None:
        """Turn the learnt weight in the observer's estimate (n_v,) [N, N m], which is changed, with
        the arm.

        q (n_q,) [m, rad], v (n_v,) [m/s, rad/s], about to be observed.
        """
        weight_before = self._weight
        velocity_before = self._velocity
        n_tools = weight_before.shape[1]
        weight, velocity = self._tool(q, v)
        self._weight = weight.reshape(-1, n_tools)
        self._velocity = velocity.reshape(-1, n_tools)
        # What is no number would never be forgotten.
        change = self._velocity - velocity_before
        follows = self._ticks > 0 and bool(np.isfinite(change).all())
        if not follows:
            self._acceleration = np.zeros_like(velocity_before)
            return
        self._acceleration = change / self._dt
        certain_weights = [0.0] * n_tools  # [N]
        for k, load in enumerate(self.loads):
            if abs(load.weight) > _CERTAIN * load.weight_error:
                certain_weights[k] = load.weight
        if self._settings.feed_forward and any(certain_weights):
            turned = (self._weight - weight_before) @ certain_weights
            moved = np.where(self._free, turned, 0.0)
            estimate += moved
            self._estimate[:, 0] += moved

    def learn(
        self, q: np.ndarray, v: np.ndarray, estimate: np.ndarray, share: np.ndarray, sure: bool
    ) -> None:
        """Learn from the observer's estimate (n_v,) [N, N m] of this tick, at q (n_q,) [m, rad] and
        v (n_v,) [m/s, rad/s].

        share (n_v,) of its bandwidth; sure: whether it observes, at velocities that are to be
        trusted. An estimate at its limit tells nothing either.
        """
        if not (sure and (np.abs(estimate) < self._limit).all()):
            self._ticks = 0
            self._innovation[:] = 0.0
            return
        current = self.filter.x[self.filter.current]
        self._estimate, self._innovation = self._response(
            q, v, self._acceleration, current, share, self._estimate, self._innovation
        )
        self._ticks += 1
        if self._ticks > self._settling and self._ticks % self._every == 0:
            self.filter.update(self._sample(estimate))

    def telemetry(self) -> dict[str, np.ndarray]:
        """Return the loads for the record [N, N, kg, kg]: numbers, or of several tools one each."""
        loads = self.loads
        series = dict[str, np.ndarray]()
        for name in ("weight", "weight_error", "mass", "mass_error"):
            series[f"load_{name}"] = np.squeeze([getattr(load, name) for load in loads])
        return series

    def _sample(self, estimate: np.ndarray) -> LoadSample:
        loads = self._estimate[:, 1:-4]
        return LoadSample(
            disturbance=estimate - self._estimate[:, 0],
            weight=loads[:, ::2],
            mass=loads[:, 1::2],
            drag=self._estimate[:, -4],
            slopes=self._estimate[:, -3:],
            velocity=self._velocity,
            usable=self._free,
        )
