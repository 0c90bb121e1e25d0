"""A tick in C goes in the order of Python's, and arrays of nothing stay so."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from uvms_ocp.codegen.kernel_layout import arrays_of
from uvms_ocp.export import tick
from uvms_ocp.export.c_controller import interface_types
from uvms_ocp.robot.dimensions import Dimensions

PARTS = ("prepare_tick", "hear_forces", "solve_and_finish", "ask_forces", "force_step")
"""In the order of `uvms_ocp.sim.tick`, which takes what the force layer met in
once the tick is prepared.
"""


def test_what_the_force_layer_met_is_heard_once_the_tick_is_prepared(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    called: list[str] = []

    def part(name: str) -> Any:
        return lambda *memories: called.append(name) or 0

    for name in PARTS:
        monkeypatch.setattr(tick, name, part(name))
    for name in ("_read_inputs", "_write_outputs"):
        monkeypatch.setattr(tick, name, lambda *memories: None)
    velocity = SimpleNamespace(tick=SimpleNamespace(mission=SimpleNamespace(phase=0)))
    force = SimpleNamespace(
        allocation=SimpleNamespace(count=0), outputs=SimpleNamespace(torque=[]), locks=False
    )
    outputs: Any = SimpleNamespace(stop=False, thrust=[], torque=[])
    memory: Any = SimpleNamespace(velocity=velocity, force=force)
    inputs: Any = SimpleNamespace()
    tick.control_force(memory, inputs, outputs)
    assert called == list(PARTS)


@pytest.mark.parametrize(("n_thrusters", "n_joints"), [(0, 0), (0, 2), (3, 0)])
def test_a_command_has_as_many_thrusts_and_torques_as_the_robot(
    n_thrusters: int, n_joints: int
) -> None:
    dimensions = Dimensions(
        n_q=7 + n_joints,
        n_v=6 + n_joints,
        n_joints=n_joints,
        n_thrusters=n_thrusters,
        n_quantities=1,
    )
    _, kind = interface_types(dimensions)
    outputs = kind()
    arrays = arrays_of(outputs)
    arrays.thrust[:] = 2.0
    command = tick.command_in(outputs, arrays, forces=True)
    assert command.thrust is not None
    assert command.torque is not None
    assert command.thrust.shape == (n_thrusters,)
    assert command.torque.shape == (n_joints,)
    arrays.thrust[:] = 3.0
    np.testing.assert_array_equal(command.thrust, np.full(n_thrusters, 2.0))
