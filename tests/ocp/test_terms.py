"""What the costs are: electrical power, and nothing that depends on where the robot is."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from uvms_ocp.model.loading import load_robot
from uvms_ocp.model.state import State
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.terms import AtRest, Energy, Term
from uvms_ocp.ocp.transcription.stage import StageModel


def _problem(name: str, term: Term) -> OcpProblem:
    robot = load_robot(name)
    start = State(q=robot.configuration(), v=np.zeros(robot.n_v))
    levels = [OcpLevel(name="cheap", terms=(term,))]
    return single_phase(robot=robot, start=start, duration=1.0, n_steps=2, levels=levels, constraints=(AtRest(),))


@pytest.mark.parametrize("name", ["girona_maris7_full", "bluerov2_alpha5"])
def test_the_squares_of_the_rows_of_energy_are_powers_in_kilowatts(name: str) -> None:
    model = StageModel(_problem(name, Energy()))
    robot, symbols, rng = model.robot, model.symbols, np.random.default_rng(3)
    rows = Energy().residual(symbols, ca.SX(0, 1)).value
    inputs = [symbols.thrust, symbols.torque, symbols.tick.velocity]
    evaluate = ca.Function("rows", [model.z], [rows, *inputs])
    for size in (30.0, 10.0, 3.0):  # far above what is rounded off at zero
        z = size * rng.uniform(-1.0, 1.0, model.z.numel())
        found, thrust, torque, v = (np.array(value).ravel() for value in evaluate(z))
        laws = [thruster.power for thruster in robot.description.thrusters]
        electric = [law.watts * (abs(T) / law.thrust) ** law.exponent for law, T in zip(laws, thrust, strict=True)]
        mechanical = np.abs(torque * v[robot.joint_v]) / robot.description.joint_efficiency
        np.testing.assert_allclose(found**2, 1e-3 * np.concatenate([electric, mechanical]), rtol=0.02, atol=0.02)
        np.testing.assert_array_equal(np.sign(found[: len(laws)]), np.sign(thrust))
