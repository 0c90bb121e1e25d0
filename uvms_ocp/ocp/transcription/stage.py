"""Functions of one step of the horizon, as CasADi SX.

Inverse-dynamics form: the acceleration is a decision, and the forces that it takes are an equality.
Nothing is solved inside the functions, so their derivatives stay short (a Hessian of forward
dynamics is ten times as long). The forces of a step are those at its middle, so that a step is
right to second order in its length (those at its beginning with `Integrator.EULER`).

Variables of a step: ``z = [q, v, h, a, f, m]`` with q [m, rad], v [m/s, rad/s], the length of the
step h [s], a [m/s2, rad/s2], thrust f and joint torque m in shares of their limits. Where every
velocity has a force of its own that nothing limits, and there is no water, f and m are expressions
in the others instead: a third of the variables and rows less. Where forces are asked to be
`eliminated` they always are: the thrust of least squares that makes the wrench, and on top of it
what cancels out among redundant thrusters, ``z = [q, v, h, a, s]`` with its coordinates s.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np

from uvms_ocp.codegen.cache_entries import content_of
from uvms_ocp.codegen.compile import available_function, compiled_from, start_compiling
from uvms_ocp.ocp.problem import Actuation, HessianKind, Integrator, OcpProblem
from uvms_ocp.ocp.terms import StageSymbols
from uvms_ocp.ocp.transcription.actuation import ActuationModel
from uvms_ocp.ocp.transcription.derivatives import (
    Derivatives,
    compiled_derivatives,
    derivatives,
)
from uvms_ocp.robot import SymbolicModel
from uvms_ocp.robot.dynamics import cached_dynamics
from uvms_ocp.robot.symbolic_bodies import sparse
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics
from uvms_ocp.robot.symbolic_model import SymbolicKinematics
from uvms_ocp.tasks.task import TickSymbols
from uvms_ocp.types import Keyed


class StageModel:
    """Symbols and dynamics of one step of a problem's robot."""

    def __init__(
        self,
        problem: OcpProblem,
        *,
        eliminated: bool = False,
        like: StageModel | None = None,
        compiled: bool = True,
    ) -> None:
        """Write the symbols of a step.

        eliminated: forces are expressions in the other variables. like: another model, whose
        dynamics serve this one too where they are the same. compiled: rows and their derivatives
        become machine code; else CasADi's virtual machine evaluates them, and nothing waits for a
        compiler.
        """
        robot = problem.robot
        self.problem = problem
        self.robot = robot
        self._like = like
        self.actuators = ActuationModel(robot, problem.actuation)
        is_direct = not robot.n_vehicle or problem.actuation is Actuation.WRENCH
        needs_force_variables = problem.water or problem.limited or not is_direct
        self.has_force_variables = needs_force_variables and not eliminated
        """True where thrust and torque are variables."""
        self.layout = StepLayout(
            n_q=robot.n_q,
            n_v=robot.n_v,
            n_thrust=self.actuators.matrix.shape[1] if self.has_force_variables else 0,
            n_torque=robot.n_joints if self.has_force_variables else 0,
            n_null=self.actuators.null.shape[1] if eliminated else 0,
        )
        self.n_forces = robot.n_v if self.has_force_variables else 0
        """Rows of forces in the dynamics."""
        self.z = ca.SX.sym("z", self.layout.n_z)
        self.water = ca.SX.sym("u", 3)
        """(3,) [m/s] velocity of the water."""
        if problem.water:
            self._dynamics = cached_dynamics(robot).symbolic
        else:
            self._dynamics = SymbolicDynamics(model=robot.model)
        self._eliminated = eliminated
        self._compiled = compiled

    @property
    def derivatives(self) -> Callable[..., Derivatives]:
        """Return `compiled_derivatives`, or `derivatives` where nothing is to be compiled."""
        if self._compiled:
            return compiled_derivatives
        return derivatives

    @property
    def kind(self) -> tuple[object, ...]:
        """Key of the dynamics: models of one key have the same."""
        problem = self.problem
        return (
            self.robot,
            problem.integrator,
            problem.actuation,
            problem.hessian,
            problem.water,
            self.layout,
            self._compiled,
        )

    @property
    def content(self) -> str:
        """Hash of the robot's forces, computed once for all models of a kind."""

        def compute() -> str:
            inputs = [self.z[: self.n_motion], self.water]
            return content_of(inputs, [self.required_force])

        return kept_content(Keyed(self.kind, compute))

    @cached_property
    def dynamics(self) -> Derivatives:
        """Rows ``[q_next, v_next, required minus actuated forces]``, the parameter is the water
        velocity (3,).

        The last rows are left out where forces are no variables.
        """
        if self._like is not None and self._like.kind == self.kind:
            return self._like.dynamics
        z = self.z
        layout = self.layout
        q = z[layout.q]
        v = z[layout.v]
        h = z[layout.h]
        a = z[layout.a]
        rows = ca.vertcat(self.moved(q, v, a, h), v + h * a)
        if self.has_force_variables:
            thrust = z[layout.thrust] * ca.DM(self.actuators.thrust_unit)
            torque = z[layout.torque] * ca.DM(self.actuators.torque_unit)
            actuated = ca.vertcat(sparse(self.actuators.matrix) @ thrust, torque)
            imbalance = (self.required_force - actuated) / ca.DM(self.actuators.force_unit)
            rows = ca.vertcat(rows, imbalance)
        is_exact = self.problem.hessian is HessianKind.EXACT
        if not (self._compiled and is_exact and self.has_force_variables):
            residuals = None if is_exact else ()
            return self.derivatives("dynamics", z, self.water, rows, residuals=residuals)
        return self._dynamics_by_force_curvature(rows)

    def _dynamics_by_force_curvature(self, rows: ca.SX) -> Derivatives:
        """Build the derivatives of the dynamics, with a Hessian made of `force_curvature`, which all
        solvers share.
        """
        # Compilations all begin before the first is waited for.
        compiling_force_curvature = self.force_curvature
        compiling_curvature = self._curvature(rows)
        compiled = compiled_derivatives("dynamics", self.z, self.water, rows, residuals=())
        force_curvature = available_function(compiling_force_curvature)
        curvature = available_function(compiling_curvature)
        z = ca.MX.sym("x", self.layout.n_z)
        water = ca.MX.sym("x", 3)
        sigma = ca.MX.sym("x", 0)
        lam = ca.MX.sym("x", rows.numel())
        force_weights = lam[-self.n_forces :] / ca.DM(self.actuators.force_unit)
        bent = force_curvature(z[: self.n_motion], water, force_weights)
        H = curvature(z, lam, bent)
        hessian = ca.Function("dynamics_hessian", [z, water, sigma, lam], [H.nz[:]])
        return replace(compiled, hessian=hessian, hessian_sparsity=curvature.sparsity_out(0))

    @property
    def n_motion(self) -> int:
        """Number of the first entries of z, up to the acceleration, on which motion and
        `required_force` depend.
        """
        return self.layout.a.stop

    @cached_property
    def force_curvature(self) -> ca.Function:
        """Function ``z up to the acceleration, water, weights -> slope and curvature`` of a weighted
        sum of forces by `midpoint`, in one column.

        Compiled by itself, for all solvers: code too long for the instruction cache is three times
        slower.
        """
        inputs = [self.z[: self.n_motion], self.water]

        def make() -> ca.Function:
            motion, w, slope, H = self._weighted_forces
            slope_and_curvature = ca.vertcat(slope, *H.nonzeros())
            bent = ca.densify(ca.substitute(slope_and_curvature, motion, self.midpoint))
            return ca.Function("force_curvature", [*inputs, w], [bent], {"cse": True})

        return compiled_from("force_curvature", self.content, make, __file__)

    @property
    def force_curvature_symbols(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Symbols for the column that `force_curvature` gives, and slope and curvature in them."""
        slope, H = self._weighted_forces[2:]
        bent = ca.SX.sym("bent", slope.numel() + H.nnz())
        n = slope.numel()
        return bent, bent[:n], ca.SX(H.sparsity(), bent[n:])

    @cached_property
    def _weighted_forces(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Symbols of the motion and of weights of forces; slope and curvature of the weighted sum of
        forces in these.
        """
        n_q = self.layout.n_q
        n_v = self.layout.n_v
        motion = ca.SX.sym("motion", n_q + 2 * n_v)
        w = ca.SX.sym("w", n_v)
        v = slice(n_q, n_q + n_v)
        slope = ca.gradient(ca.dot(w, self.forces_of(motion)), motion)
        # Forces are linear in the acceleration, with a factor in which no velocity is.
        H = ca.jacobian(slope[:n_q], motion)
        fast = ca.jacobian(slope[v], motion)[:, v]  # in velocities alone
        lower_right = ca.diagcat(fast, ca.SX(n_v, n_v))
        hessian = ca.blockcat([[H[:, :n_q], H[:, n_q:]], [H[:, n_q:].T, lower_right]])
        return motion, w, slope, ca.sparsify(hessian)

    def _curvature(self, rows: ca.SX) -> ca.Function:
        """Build the function ``z, multipliers of rows, force curvature -> H`` of the dynamics."""
        z = self.z
        lam = ca.SX.sym("lam", rows.numel())
        middle = self.midpoint

        def make() -> ca.Function:
            bent, slope, H = self.force_curvature_symbols
            D = ca.jacobian(middle, z)
            n = rows.numel() - self.n_forces
            weighted_motion = ca.dot(slope, middle) + ca.dot(lam[:n], rows[:n])
            H = D.T @ H @ D + ca.hessian(weighted_motion, z)[0]
            return ca.Function("dynamics_curvature", [z, lam, bent], [H], {"cse": True})

        return compiled_from(
            "dynamics_curvature",
            content_of([z, self.water], [rows, middle], self.n_forces),
            make,
            __file__,
        )

    @cached_property
    def required_force(self) -> ca.SX:
        """Generalised forces (n_v,) [N, N m] that the motion of a step needs."""
        return self.forces_of(self.midpoint)

    @cached_property
    def midpoint(self) -> ca.SX:
        """q, v and a (n_q + 2 n_v,) at the time in a step for which its forces are computed."""
        z = self.z
        layout = self.layout
        q = z[layout.q]
        v = z[layout.v]
        h = z[layout.h]
        a = z[layout.a]
        if self.problem.integrator is Integrator.EULER:
            return ca.vertcat(q, v, a)
        return ca.vertcat(self.moved(q, v, a, h / 2), v + h / 2 * a, a)

    def forces_of(self, motion: ca.SX) -> ca.SX:
        """Compute the generalised forces (n_v,) [N, N m] of a motion q, v and a (n_q + 2 n_v,)."""
        n_q = self.layout.n_q
        n_v = self.layout.n_v
        q = motion[:n_q]
        v = motion[n_q : n_q + n_v]
        a = motion[n_q + n_v :]
        water_at_links = ca.repmat(self.water, 1, len(self._dynamics.links))
        water_acceleration = ca.SX(*water_at_links.shape)  # none
        return self._dynamics.inverse_dynamics(q, v, a, water_at_links, water_acceleration)

    @cached_property
    def force(self) -> ca.SX:
        """(n_v,) [N, N m] `required_force`; where forces are `eliminated`, a symbol for it, so that
        it is differentiated once for all rows.
        """
        if self._eliminated:
            return ca.SX.sym("f", self.robot.n_v)
        return self.required_force

    @cached_property
    def inputs(self) -> tuple[ca.SX, ca.SX]:
        """Thrust and torque of a step, in shares of their limits."""
        if self.has_force_variables:
            return self.z[self.layout.thrust], self.z[self.layout.torque]
        n = self.robot.n_vehicle
        force = self.force
        actuators = self.actuators
        least_squares = sparse(actuators.spread) @ force[:n, 0]
        cancelling = sparse(actuators.null) @ self.z[self.layout.null]
        torque = force[n:, 0] / ca.DM(actuators.torque_unit)
        return least_squares + cancelling, torque

    @cached_property
    def inputs_function(self) -> ca.Function:
        """Function ``z, water -> thrust, torque``, in shares of their limits."""
        outputs = [ca.densify(part) for part in self.inputs]
        function = ca.Function("inputs", [self.z, self.water], outputs)
        if self.has_force_variables:
            return function
        return available_function(start_compiling(function))

    def moved(self, q: ca.SX, v: ca.SX, a: ca.SX, h: ca.SX) -> ca.SX:
        """Return the configuration after a time h of constant acceleration."""
        if self.problem.integrator is Integrator.EULER:
            step = h * v + h**2 * a
        else:
            step = h * v + h**2 / 2 * a
        if self.problem.integrator is Integrator.MAGNUS and self.robot.n_vehicle:
            # For V = v + a t the series of Magnus begins with
            # Omega = int V + 1/2 int int [V(s), V(t)] = h v + h^2/2 a + h^3/12 [v, a].
            step[:6] += h**3 / 12 * _commutator(v[:6], a[:6])
        return self._dynamics.symbolic.integrate(q, step)

    @cached_property
    def symbols(self) -> StageSymbols:
        """Return the symbols that terms are written in."""
        z = self.z
        layout = self.layout
        thrust_share, torque_share = self.inputs
        kinematics = SymbolicModel(self.robot.model).forward_kinematics(z[layout.q])
        tick = TickSymbols(
            robot=self.robot,
            kinematics=kinematics,
            q=z[layout.q],
            velocity=z[layout.v],
            altimeter_range=altimeter_range(self.problem, kinematics),
            dt=float("nan"),
        )
        return StageSymbols(
            tick=tick,
            acceleration=z[layout.a],
            thrust=thrust_share * ca.DM(self.actuators.thrust_unit),
            thrust_share=thrust_share,
            torque=torque_share * ca.DM(self.actuators.torque_unit),
            torque_share=torque_share,
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class StepLayout:
    """Layout of the parts of z, by their sizes."""

    n_q: int
    n_v: int
    n_thrust: int
    n_torque: int
    n_null: int = 0
    """Number of coordinates of what cancels out among redundant thrusters."""

    # Places of these parts in z.
    q: slice = field(init=False, compare=False)
    v: slice = field(init=False, compare=False)
    a: slice = field(init=False, compare=False)
    thrust: slice = field(init=False, compare=False)
    torque: slice = field(init=False, compare=False)
    null: slice = field(init=False, compare=False)
    h: int = field(init=False, compare=False)
    n_z: int = field(init=False, compare=False)

    def __post_init__(self) -> None:
        sizes = {
            "q": self.n_q,
            "v": self.n_v,
            "h": 1,
            "a": self.n_v,
            "thrust": self.n_thrust,
            "torque": self.n_torque,
            "null": self.n_null,
        }
        first = 0
        for name, size in sizes.items():
            place = first if name == "h" else slice(first, first + size)
            object.__setattr__(self, name, place)
            first += size
        object.__setattr__(self, "n_z", first)


@lru_cache(maxsize=8)
def kept_content(model_hash: Keyed) -> str:
    """Return the hash that the function in `model_hash` computes, once for each kind of model,
    which is its key.
    """
    return str(model_hash.value())


def altimeter_range(problem: OcpProblem, kinematics: SymbolicKinematics) -> ca.SX:
    """Return the range [m] over a level floor: the height above it over the cosine of the beam's
    tilt.
    """
    if not np.isfinite(problem.floor) or not problem.robot.has_frame(problem.altimeter_frame):
        return ca.SX(ca.inf)
    R, p = kinematics.pose(problem.altimeter_frame)
    return (p[2] - problem.floor) / R[2, 2]


def _commutator(v: ca.SX, a: ca.SX) -> ca.SX:
    """Return the Lie bracket of body twists, ``d/ds`` of the adjoint action of exp(s v) on a."""
    linear = ca.cross(v[3:], a[:3]) + ca.cross(v[:3], a[3:])
    angular = ca.cross(v[3:], a[3:])
    return ca.vertcat(linear, angular)
