"""What problems are made of: the cost that is electrical power, and guesses that are packed as they
are.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.terms import _ROUNDING, AtRest, Energy, Smoothness, Term, _root_of_power
from uvms_ocp.ocp.trajectory import guess_through, hold_guess
from uvms_ocp.ocp.transcription.stage import StageModel
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.signals import State


def _problem(name: str, term: Term) -> OcpProblem:
    robot = load_robot(name)
    start = State(q=robot.configuration(), v=np.zeros(robot.n_v))
    levels = [OcpLevel(name="cheap", terms=(term,))]
    return single_phase(
        robot=robot, start=start, duration=1.0, n_steps=4, levels=levels, constraints=(AtRest(),)
    )


@pytest.mark.parametrize("name", ["girona_maris7_full", "bluerov2_alpha5"])
def test_the_squares_of_the_rows_of_energy_are_powers_in_kilowatts(name: str) -> None:
    model = StageModel(_problem(name, Energy()))
    robot = model.robot
    symbols = model.symbols
    rng = np.random.default_rng(3)
    rows = Energy().residual(symbols, ca.SX(0, 1)).value
    inputs = [symbols.thrust, symbols.torque, symbols.tick.velocity]
    evaluate = ca.Function("rows", [model.z], [rows, *inputs])
    for size in (30.0, 10.0, 3.0):  # far above what is rounded off at zero
        z = size * rng.uniform(-1.0, 1.0, model.z.numel())
        found, thrust, torque, v = (np.array(value).ravel() for value in evaluate(z))
        laws = [thruster.power for thruster in robot.description.thrusters]
        electric = [
            law.watts * (abs(T) / law.thrust) ** law.exponent
            for law, T in zip(laws, thrust, strict=True)
        ]
        mechanical = np.abs(torque * v[robot.joint_v]) / robot.description.joint_efficiency
        np.testing.assert_allclose(
            found**2, 1e-3 * np.concatenate([electric, mechanical]), rtol=0.02, atol=0.02
        )
        np.testing.assert_array_equal(np.sign(found[: len(laws)]), np.sign(thrust))


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0])
def test_roots_of_powers_leave_zero_along_their_chord_over_what_is_rounded_off(
    exponent: float,
) -> None:
    """So that squares of rows have a curvature at rest that is that of small efforts, not of
    none.
    """
    x = ca.SX.sym("x")
    root = ca.Function(
        "root", [x], [_root_of_power(x, exponent), ca.jacobian(_root_of_power(x, exponent), x)]
    )
    chord = _ROUNDING ** (exponent / 2) / _ROUNDING
    for side in (-1.0, 1.0):
        assert float(root(side * 1e-9)[0]) == pytest.approx(side * 1e-9 * chord)
        assert float(root(side)[0]) == pytest.approx(side, rel=_ROUNDING**2)
    assert float(root(0.0)[1]) == pytest.approx(chord)


@pytest.mark.parametrize("name", ["girona_maris7_full", "planar5"])
def test_a_guess_comes_out_of_the_variables_as_it_went_in(name: str) -> None:
    problem = _problem(name, Smoothness())
    rng = np.random.default_rng(4)
    guess = hold_guess(problem)
    parts = {
        part: rng.uniform(-0.1, 0.1, getattr(guess, part).shape)
        for part in ("v", "a", "thrust", "torque")
    }
    guess = replace(guess, **parts)
    transcription = Transcription(problem)
    found = transcription.unpack(transcription.pack(guess))
    for part in ("t", "q", *parts):
        np.testing.assert_allclose(getattr(found, part), getattr(guess, part), atol=1e-12)


def test_a_guess_through_a_steady_motion_has_its_velocity_and_no_acceleration() -> None:
    problem = _problem("girona_maris7_full", Energy())
    robot = problem.robot
    times = np.linspace(0.0, 1.0, 7)
    v = np.random.default_rng(5).uniform(-0.1, 0.1, robot.n_v)
    v[:6] = 0.1, -0.05, 0.02, 0.0, 0.0, 0.08
    problem = replace(problem, start=State(q=problem.start.q, v=v))
    q = np.array([pin.integrate(robot.model, problem.start.q, t * v) for t in times])
    guess = guess_through(problem, times, q)
    np.testing.assert_allclose(guess.v, np.tile(v, (len(guess.t), 1)), atol=1e-9)
    np.testing.assert_allclose(guess.a, 0.0, atol=1e-8)
