"""Functions of one step of the horizon, with sparse first and second derivatives, as CasADi SX;
what moves the robot.

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

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache, partial

import casadi as ca
import numpy as np

from uvms_ocp.codegen.compile import available_function, compiled_from, content_of, start_compiling
from uvms_ocp.ocp.problem import Actuation, HessianKind, Integrator, OcpProblem
from uvms_ocp.ocp.terms import StageSymbols, finite_or
from uvms_ocp.robot import Robot, SymbolicModel
from uvms_ocp.robot.dynamics import cached_dynamics
from uvms_ocp.robot.symbolic_bodies import sparse
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics
from uvms_ocp.robot.symbolic_model import SymbolicKinematics
from uvms_ocp.robot.thrusters import thrust_limits, thruster_matrix
from uvms_ocp.tasks.task import TickSymbols
from uvms_ocp.types import Keyed

# What moves a robot: its thrusters or a wrench on the vehicle, and its joints.

_UNLIMITED_EFFORT = 10.0  # [N m] unit of torque where the robot has no limit
_RANK = 1e-9  # of a singular value of the thruster matrix
_VEHICLE_FORCE = 100.0  # [N, N m] unit of the wrench on a vehicle without thrusters


class ActuationModel:
    """Matrix, units and limits of what moves the robot."""

    def __init__(self, robot: Robot, actuation: Actuation) -> None:
        thrusters = bool(robot.n_vehicle) and actuation is Actuation.THRUSTERS
        n = robot.n_vehicle
        if thrusters:
            self.matrix = thruster_matrix(robot)[:n]
            limits = thrust_limits(robot)
        else:
            self.matrix = np.eye(n)
            limits = (np.full(n, -np.inf), np.full(n, np.inf))
        self.thrust_unit = finite_or(
            np.maximum(np.abs(limits[0]), np.abs(limits[1])), _VEHICLE_FORCE
        )
        self.thrust_lower, self.thrust_upper = (limit / self.thrust_unit for limit in limits)
        self.torque_unit = finite_or(robot.limits.effort, _UNLIMITED_EFFORT)
        self.torque_limit = robot.limits.effort / self.torque_unit
        reach = np.abs(self.matrix) @ self.thrust_unit / 4
        self.force_unit = np.concatenate(
            [np.maximum(reach, 1e-3 * reach.max(initial=1.0)), self.torque_unit]
        )

    @cached_property
    def spread(self) -> np.ndarray:
        """(n_thrust, n_vehicle) least thrust in shares for a wrench [N, N m]."""
        return np.asarray(np.linalg.pinv(self.matrix * self.thrust_unit, rcond=_RANK))

    @cached_property
    def null(self) -> np.ndarray:
        """(n_thrust, n) thrust in shares that cancels out."""
        return self._complement((self.matrix * self.thrust_unit).T)

    @cached_property
    def beyond(self) -> np.ndarray:
        """(n_vehicle, n) directions of a wrench that no thrust makes, in shares of its units."""
        return self._complement(self.matrix / self.force_unit[: len(self.matrix), None])

    @staticmethod
    def _complement(matrix: np.ndarray) -> np.ndarray:
        """Orthonormal directions (n, ...) that are orthogonal to all columns of a matrix (n, m)."""
        U, sizes, _ = np.linalg.svd(matrix, full_matrices=True)
        return np.asarray(U[:, int(np.sum(sizes > _RANK * sizes.max(initial=0.0))) :])


# Functions of one step of the horizon, with sparse first and second derivatives, as CasADi SX.


@dataclass(frozen=True, kw_only=True, slots=True)
class StepLayout:
    """Layout of the parts of z."""

    n_q: int
    n_v: int
    n_thrust: int
    n_torque: int
    n_null: int = 0

    q: slice = field(init=False, compare=False)
    v: slice = field(init=False, compare=False)
    a: slice = field(init=False, compare=False)
    thrust: slice = field(init=False, compare=False)
    torque: slice = field(init=False, compare=False)
    null: slice = field(init=False, compare=False)
    h: int = field(init=False, compare=False)
    n_z: int = field(init=False, compare=False)

    def __post_init__(self) -> None:
        sizes = {"q": self.n_q, "v": self.n_v, "h": 1, "a": self.n_v}
        sizes |= {"thrust": self.n_thrust, "torque": self.n_torque, "null": self.n_null}
        ends = np.cumsum([0, *sizes.values()]).tolist()
        for name, first, stop in zip(sizes, ends[:-1], ends[1:], strict=True):
            object.__setattr__(self, name, first if name == "h" else slice(first, stop))
        object.__setattr__(self, "n_z", ends[-1])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Derivatives:
    """A vector function ``(z, s) -> rows`` of variables z and parameters s, with a scalar cost and
    its derivatives.

    `value`: rows (m,). `jacobian`: nonzeros of d rows / dz. `hessian`: nonzeros of the second
    derivative of ``sigma' costs + lam' rows`` (upper and lower part). `gradient`: of ``sigma'
    costs``. `costs` (n_costs,).
    """

    value: ca.Function
    jacobian: ca.Function
    hessian: ca.Function
    costs: ca.Function
    gradient: ca.Function
    jacobian_sparsity: ca.Sparsity
    hessian_sparsity: ca.Sparsity


def derivatives(
    name: str,
    z: ca.SX,
    s: ca.SX,
    rows: ca.SX,
    *,
    costs: ca.SX | None = None,
    residuals: Sequence[ca.SX] | None = None,
) -> Derivatives:
    """Functions of rows (m,) and costs in z and s.

    With `residuals`, vectors r whose ``1/2 |r|^2`` are the costs, the Hessian is that of Gauss and Newton: no curvature
    of residuals or rows.
    """
    if costs is None:
        c = ca.SX(0, 1)
    else:
        c = costs
    sigma = ca.SX.sym("sigma", c.shape[0])
    lam = ca.SX.sym("lam", rows.shape[0])
    J = ca.jacobian(rows, z)
    if c.numel():
        gradient = ca.gradient(ca.dot(sigma, c), z)
    else:
        gradient = ca.SX.zeros(z.shape)
    lagrangian = ca.dot(sigma, c) + ca.dot(lam, rows)
    if residuals is None:
        H = ca.hessian(lagrangian, z)[0]
    else:
        H = _gauss_newton(residuals, sigma, z)

    def function(kind: str, inputs: list[ca.SX], output: ca.SX) -> ca.Function:
        # Common subexpressions are shared by how rows are written: looking for more takes as long
        # as all else, for 4 %.
        return ca.Function(f"{name}_{kind}", inputs, [ca.densify(output)])

    return Derivatives(
        value=function("value", [z, s], rows),
        jacobian=function("jacobian", [z, s], _nonzeros(J)),
        hessian=function("hessian", [z, s, sigma, lam], _nonzeros(H)),
        costs=function("costs", [z, s], c),
        gradient=function("gradient", [z, s, sigma], gradient),
        jacobian_sparsity=J.sparsity(),
        hessian_sparsity=H.sparsity(),
    )


def _gauss_newton(residuals: Sequence[ca.SX], sigma: ca.SX, z: ca.SX) -> ca.SX:
    H = ca.SX(z.shape[0], z.shape[0])
    for i, residual in enumerate(residuals):
        J = ca.jacobian(residual, z)
        H += sigma[i] * (J.T @ J)
    return H


def _nonzeros(matrix: ca.SX) -> ca.SX:
    return ca.vertcat(ca.SX(0, 1), *matrix.nonzeros())


@lru_cache(maxsize=8)
def kept_content(model_hash: Keyed) -> str:
    """Return the hash that the function in `given` computes, once for each kind of model, which is
    its key.
    """
    return str(model_hash.value())


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
        """like: another model, whose dynamics serve here too where they are the same. compiled:
        rows and their derivatives become machine code; else CasADi's virtual machine evaluates
        them, and nothing waits for a compiler.
        """
        robot = problem.robot
        self.problem = problem
        self.robot = robot
        self._like = like
        self.actuators = ActuationModel(robot, problem.actuation)
        direct = not robot.n_vehicle or problem.actuation is Actuation.WRENCH
        self.has_force_variables = not eliminated and (
            problem.water or problem.limited or not direct
        )
        n_thrust, n_torque = (
            (self.actuators.matrix.shape[1], robot.n_joints) if self.has_force_variables else (0, 0)
        )
        n_null = self.actuators.null.shape[1] if eliminated else 0
        self.layout = StepLayout(
            n_q=robot.n_q, n_v=robot.n_v, n_thrust=n_thrust, n_torque=n_torque, n_null=n_null
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
        """Return the key of the dynamics."""
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
        """Hash of the robot's forces, which are not written out anew for each model of a kind."""
        return kept_content(
            Keyed(
                self.kind,
                lambda: content_of([self.z[: self.n_motion], self.water], [self.required_force]),
            )
        )

    @cached_property
    def dynamics(self) -> Derivatives:
        """Rows ``[q_next, v_next, wanted minus given forces]``, the parameter is the water velocity
        (3,).

        The last rows are left out where forces are no variables.
        """
        if self._like is not None and self._like.kind == self.kind:
            return self._like.dynamics
        z, layout = self.z, self.layout
        q = z[layout.q]
        v = z[layout.v]
        h = z[layout.h]
        a = z[layout.a]
        rows = ca.vertcat(self.moved(q, v, a, h), v + h * a)
        if self.has_force_variables:
            actuated = ca.vertcat(
                sparse(self.actuators.matrix)
                @ (z[layout.thrust] * ca.DM(self.actuators.thrust_unit)),
                z[layout.torque] * ca.DM(self.actuators.torque_unit),
            )
            rows = ca.vertcat(
                rows, (self.required_force - actuated) / ca.DM(self.actuators.force_unit)
            )
        exact = self.problem.hessian is HessianKind.EXACT
        if not (self._compiled and exact and self.has_force_variables):
            return self.derivatives(
                "dynamics", z, self.water, rows, residuals=None if exact else ()
            )
        begun = self.bend, self._curvature(rows)
        compiled = compiled_derivatives("dynamics", z, self.water, rows, residuals=())
        bend, curvature = (available_function(function) for function in begun)
        x, s, sigma, lam = (ca.MX.sym("x", size) for size in (layout.n_z, 3, 0, rows.numel()))
        bent = bend(x[: self.n_motion], s, lam[-self.n_forces :] / ca.DM(self.actuators.force_unit))
        hessian = ca.Function(
            "dynamics_hessian", [x, s, sigma, lam], [curvature(x, lam, bent).nz[:]]
        )
        return replace(compiled, hessian=hessian, hessian_sparsity=curvature.sparsity_out(0))

    @property
    def n_motion(self) -> int:
        """First entries of z, up to the acceleration, on which motion and `required_force`
        depend.
        """
        return self.layout.a.stop

    @cached_property
    def bend(self) -> ca.Function:
        """``z up to the acceleration, water, weights -> bent``: slope and curvature of a weighted
        sum of forces by `midpoint`.

        Compiled by itself, for all solvers: code too long for the instruction cache is three times
        slower.
        """
        inputs = [self.z[: self.n_motion], self.water]

        def make() -> ca.Function:
            motion, w, slope, H = self._force_curvature
            found = ca.densify(
                ca.substitute(ca.vertcat(slope, *H.nonzeros()), motion, self.midpoint)
            )
            return ca.Function("force_curvature", [*inputs, w], [found], {"cse": True})

        return compiled_from("force_curvature", self.content, make, __file__)

    @property
    def bent(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Symbols for what `bend` gives, and the slope and the curvature in them."""
        slope, H = self._force_curvature[2:]
        bent = ca.SX.sym("bent", slope.numel() + H.nnz())
        n = slope.numel()
        return bent, bent[:n], ca.SX(H.sparsity(), bent[n:])

    @cached_property
    def _force_curvature(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Motion, weights, slope and curvature."""
        n_q, n_v = self.layout.n_q, self.layout.n_v
        motion = ca.SX.sym("motion", n_q + 2 * n_v)
        w = ca.SX.sym("w", n_v)
        v = slice(n_q, n_q + n_v)
        slope = ca.gradient(ca.dot(w, self.forces_of(motion)), motion)
        # Forces are linear in the acceleration, with a factor in which no velocity is.
        H = ca.jacobian(slope[:n_q], motion)
        fast = ca.jacobian(slope[v], motion)[:, v]
        hessian = ca.blockcat(
            [[H[:, :n_q], H[:, n_q:]], [H[:, n_q:].T, ca.diagcat(fast, ca.SX(n_v, n_v))]]
        )
        return motion, w, slope, ca.sparsify(hessian)

    def _curvature(self, rows: ca.SX) -> ca.Function:
        """``z, multipliers of rows, bent -> H`` of the dynamics."""
        z = self.z
        lam = ca.SX.sym("lam", rows.numel())
        middle = self.midpoint

        def make() -> ca.Function:
            bent, slope, H = self.bent
            D = ca.jacobian(middle, z)
            n = rows.numel() - self.n_forces
            H = D.T @ H @ D + ca.hessian(ca.dot(slope, middle) + ca.dot(lam[:n], rows[:n]), z)[0]
            return ca.Function("dynamics_curvature", [z, lam, bent], [H], {"cse": True})

        return compiled_from(
            "dynamics_curvature",
            content_of([z, self.water], [rows, middle], self.n_forces),
            make,
            __file__,
        )

    @cached_property
    def required_force(self) -> ca.SX:
        """Generalised forces (n_v,) [N, N m] that a step takes."""
        return self.forces_of(self.midpoint)

    @cached_property
    def midpoint(self) -> ca.SX:
        """Q, v and a (n_q + 2 n_v,) where the forces of a step are."""
        z, layout = self.z, self.layout
        q = z[layout.q]
        v = z[layout.v]
        h = z[layout.h]
        a = z[layout.a]
        if self.problem.integrator is Integrator.EULER:
            return ca.vertcat(q, v, a)
        return ca.vertcat(self.moved(q, v, a, h / 2), v + h / 2 * a, a)

    def forces_of(self, motion: ca.SX) -> ca.SX:
        """Generalised forces (n_v,) [N, N m] of a motion q, v and a (n_q + 2 n_v,)."""
        n_q = self.layout.n_q
        n_v = self.layout.n_v
        u = self.water
        u_links = ca.repmat(u, 1, len(self._dynamics.links))
        parts = (motion[:n_q], motion[n_q : n_q + n_v], motion[n_q + n_v :])
        return self._dynamics.inverse_dynamics(*parts, u_links, ca.SX(*u_links.shape))

    @cached_property
    def force(self) -> ca.SX:
        """(n_v,) [N, N m] `wanted`; where forces are `eliminated` a symbol for it: differentiated
        once for all rows.
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
        thrust = (
            sparse(actuators.spread) @ force[:n, 0]
            + sparse(actuators.null) @ self.z[self.layout.null]
        )
        return thrust, force[n:, 0] / ca.DM(actuators.torque_unit)

    @cached_property
    def inputs_function(self) -> ca.Function:
        """``z, water -> thrust, torque`` in shares of their limits."""
        function = ca.Function(
            "inputs", [self.z, self.water], [ca.densify(part) for part in self.inputs]
        )
        if self.has_force_variables:
            return function
        return available_function(start_compiling(function))

    def moved(self, q: ca.SX, v: ca.SX, a: ca.SX, h: ca.SX) -> ca.SX:
        """Configuration after the time h of constant acceleration."""
        if self.problem.integrator is Integrator.EULER:
            step = h * v + h**2 * a
        else:
            step = h * v + h**2 / 2 * a
        if self.problem.integrator is Integrator.MAGNUS and self.robot.n_vehicle:
            # Omega = int V + 1/2 int int [V(s), V(t)] ... = h v + h^2/2 a + h^3/12 [v, a] for V = v
            # + a t.
            step[:6] += h**3 / 12 * _commutator(v[:6], a[:6])
        return self._dynamics.symbolic.integrate(q, step)

    @cached_property
    def symbols(self) -> StageSymbols:
        """Return the symbols that terms are written in."""
        z, layout = self.z, self.layout
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


def altimeter_range(problem: OcpProblem, kinematics: SymbolicKinematics) -> ca.SX:
    """Range over a level floor: what makes the vertical part of the beam the height above it."""
    if not np.isfinite(problem.floor) or not problem.robot.has_frame(problem.altimeter_frame):
        return ca.SX(ca.inf)
    R, p = kinematics.pose(problem.altimeter_frame)
    return (p[2] - problem.floor) / R[2, 2]


def _commutator(v: ca.SX, a: ca.SX) -> ca.SX:
    """Lie bracket of body twists, ``d/ds`` of the adjoint action of exp(s v) on a."""
    return ca.vertcat(ca.cross(v[3:], a[:3]) + ca.cross(v[:3], a[3:]), ca.cross(v[3:], a[3:]))


def compiled_derivatives(
    name: str,
    z: ca.SX,
    s: ca.SX,
    rows: ca.SX,
    *,
    costs: ca.SX | None = None,
    residuals: Sequence[ca.SX] | None = None,
) -> Derivatives:
    """`derivatives` in machine code where a C compiler exists, not made anew where they were
    compiled before.
    """
    outputs = [rows, *([] if costs is None else [costs]), *(residuals or ())]
    content = content_of([z, s], outputs, costs is None, residuals is None)

    @cache
    def made() -> Derivatives:
        return derivatives(name, z, s, rows, costs=costs, residuals=residuals)

    def of_kind(kind: str) -> ca.Function:
        return getattr(made(), kind)

    def patterns() -> ca.Function:
        ones = [
            ca.SX(pattern, 1) for pattern in (made().jacobian_sparsity, made().hessian_sparsity)
        ]
        return ca.Function(f"{name}_patterns", [], ones)

    kinds = ("value", "jacobian", "hessian", "costs", "gradient")
    begun = {
        kind: compiled_from(f"{name}_{kind}", content, partial(of_kind, kind), __file__)
        for kind in kinds
    }
    sparsities = available_function(compiled_from(f"{name}_patterns", content, patterns, __file__))
    return Derivatives(
        **{kind: available_function(function) for kind, function in begun.items()},
        jacobian_sparsity=sparsities.sparsity_out(0),
        hessian_sparsity=sparsities.sparsity_out(1),
    )
