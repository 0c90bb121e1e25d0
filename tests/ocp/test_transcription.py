"""Laws of transcribed problems: derivatives, integrators, forces, and solvers that agree."""

from __future__ import annotations

from dataclasses import fields, replace

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from reaches import PATIENCE, patient, reach

from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.planner import Planner
from uvms_ocp.ocp.problem import Actuation, HessianKind, Integrator
from uvms_ocp.ocp.trajectory import hold_guess
from uvms_ocp.ocp.transcription.stage import StageModel
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.hydrodynamics import Water
from uvms_ocp.robot.limits import Limits
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.thrusters import thruster_matrix
from uvms_ocp.solvers.nlp.options import NlpOptions

pytestmark = pytest.mark.slow

DRY: dict[str, object] = {"water": False, "limited": False, "actuation": Actuation.WRENCH}
"""Nothing limits the forces, so that they are no variables."""


@pytest.fixture(scope="module")
def weightless(robot: Robot) -> Robot:
    model = pin.Model(robot.model)
    model.gravity = pin.Motion.Zero()
    return replace(robot, model=model)


@pytest.mark.parametrize(
    "options", [{}, DRY, DRY | {"integrator": Integrator.EULER}], ids=["wet", "dry", "euler"]
)
def test_derivatives_equal_finite_differences(robot: Robot, options: dict[str, object]) -> None:
    transcription = Transcription(reach(robot, n_steps=3, **options))
    rng = np.random.default_rng(1)
    p = transcription.parameters()
    x = transcription.pack(hold_guess(transcription.problem)) + 0.05 * rng.standard_normal(
        transcription.n_x
    )
    d = rng.standard_normal(transcription.n_x)
    e = 1e-6
    for level in transcription.program.nlps:
        functions = level.functions
        lam = rng.standard_normal(len(level.rows))

        def slope(at: np.ndarray, functions: dict = functions, lam: np.ndarray = lam) -> np.ndarray:
            J = functions["nlp_jac_g"](at, p)[1].full()
            return np.array(functions["nlp_grad_f"].call([at, p])[-1]).ravel() + J.T @ lam

        f = functions["nlp_f"]
        g = functions["nlp_g"]
        total = [
            float(f(at, p)) + lam @ np.array(g(at, p)).ravel() for at in (x + e * d, x - e * d)
        ]
        assert (total[0] - total[1]) / (2 * e) == pytest.approx(slope(x) @ d, rel=1e-6)
        H = functions["nlp_hess_l"].call([x, p, 1.0, lam])[-1].full()
        H = np.triu(H) + np.triu(H, 1).T
        np.testing.assert_allclose(
            (slope(x + e * d) - slope(x - e * d)) / (2 * e), H @ d, atol=1e-5
        )


@pytest.mark.parametrize("last", [(0.2, -0.1, 0.0), (-0.2, 0.1, 0.1)], ids=["uniform", "turning"])
def test_forces_are_those_of_the_motion_in_the_middle_of_every_step(
    robot: Robot, last: tuple[float, float, float]
) -> None:
    currents = np.linspace((0.2, -0.1, 0.0), last, 10)
    problem = reach(robot, n_steps=10, current=currents)
    trajectory = patient(problem).plan().trajectory
    dynamics = robot_dynamics(robot)
    matrix = thruster_matrix(robot)
    for k, h in enumerate(np.diff(trajectory.t)):
        q, v, a = trajectory.state_at(robot.model, trajectory.t[k] + h / 2)
        required = dynamics.inverse_dynamics(q, v, a, Water(velocity=currents[k]))
        actuated = np.concatenate([matrix @ trajectory.thrust[k], trajectory.torque[k]])
        np.testing.assert_allclose(actuated, required, atol=1e-3)


def test_forces_that_are_no_variables_are_those_of_the_motion(weightless: Robot) -> None:
    trajectory = patient(reach(weightless, n_steps=10, **DRY)).plan().trajectory
    data = weightless.model.createData()
    for k, h in enumerate(np.diff(trajectory.t)):
        required = pin.rnea(
            weightless.model, data, *trajectory.state_at(weightless.model, trajectory.t[k] + h / 2)
        )
        actuated = np.concatenate([trajectory.thrust[k], trajectory.torque[k]])
        np.testing.assert_allclose(actuated, required, atol=1e-8)


def test_plans_with_and_without_forces_as_variables_are_the_same(weightless: Robot) -> None:
    unlimited = {
        field.name: np.full_like(getattr(weightless.limits, field.name), np.inf)
        for field in fields(Limits)
    }
    unlimited["position_lower"] = -unlimited["position_lower"]
    free = replace(weightless, limits=Limits(**unlimited))
    problems = [reach(free, n_steps=10, **DRY | {"limited": limited}) for limited in (False, True)]
    without, with_forces = (patient(problem).plan().trajectory for problem in problems)
    np.testing.assert_allclose(without.q, with_forces.q, atol=1e-5)
    np.testing.assert_allclose(without.thrust, with_forces.thrust, atol=1e-2)


def test_a_semi_implicit_step_moves_with_the_new_velocity_under_the_forces_of_the_old_state(
    weightless: Robot,
) -> None:
    trajectory = (
        patient(reach(weightless, n_steps=10, **DRY, integrator=Integrator.EULER)).plan().trajectory
    )
    data = weightless.model.createData()
    for k, h in enumerate(np.diff(trajectory.t)):
        actuated = np.concatenate([trajectory.thrust[k], trajectory.torque[k]])
        a = pin.aba(weightless.model, data, trajectory.q[k], trajectory.v[k], actuated)
        v = trajectory.v[k] + h * a
        np.testing.assert_allclose(trajectory.v[k + 1], v, atol=1e-7)
        np.testing.assert_allclose(
            trajectory.q[k + 1], pin.integrate(weightless.model, trajectory.q[k], h * v), atol=1e-7
        )


def test_both_solvers_find_the_same_cost(robot: Robot, planner: Planner) -> None:
    ipopt = patient(reach(robot), "ipopt").plan()
    assert ipopt.status is OcpStatus.SOLVED
    assert planner.plan().levels[1].residual ** 2 == pytest.approx(
        ipopt.levels[1].residual ** 2, rel=1e-6
    )


def test_gauss_newton_finds_the_same_cost_as_the_exact_hessian(
    robot: Robot, planner: Planner
) -> None:
    exact = planner.plan()
    # Without the curvature of the dynamics convergence is linear.
    loose = NlpOptions(time_limit=PATIENCE, convergence=1e-6)
    gauss_newton = Planner(reach(robot, hessian=HessianKind.GAUSS_NEWTON), loose).plan()
    assert gauss_newton.status is OcpStatus.SOLVED
    assert gauss_newton.levels[1].residual ** 2 == pytest.approx(
        exact.levels[1].residual ** 2, rel=1e-3
    )


def test_the_magnus_integrator_follows_constant_acceleration_more_closely(robot: Robot) -> None:
    q = robot.configuration()
    rng = np.random.default_rng(3)
    v = 0.5 * rng.standard_normal(robot.n_v)
    a = 0.5 * rng.standard_normal(robot.n_v)
    h = 0.5
    exact = q
    for i in range(2000):
        exact = pin.integrate(robot.model, exact, (v + (i + 0.5) * h / 2000 * a) * h / 2000)
    errors = []
    for kind in Integrator:
        problem = reach(robot, n_steps=1, integrator=kind)
        moved = np.array(
            ca.DM(StageModel(problem).moved(ca.SX(q), ca.SX(v), ca.SX(a), ca.SX(h)))
        ).ravel()
        errors.append(np.linalg.norm(pin.difference(robot.model, exact, moved)))
    assert errors[1] < 0.1 * errors[0]
