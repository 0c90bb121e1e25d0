"""Real numbers of tasks are symbols in the levels, which are the same whatever stands in their
place.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from task_registry import REGISTRY

from uvms_ocp.control.velocity import levels
from uvms_ocp.robot import load_robot
from uvms_ocp.tasks import Hierarchy


@pytest.mark.parametrize(
    "name", [name for name in REGISTRY if levels.numbers_of(REGISTRY[name].task)]
)
def test_levels_of_symbols_are_those_of_numbers(name: str) -> None:
    """Of a class of a user's own the numbers stay numbers."""
    robot = load_robot("girona_maris7_full")
    task = REGISTRY[name].task
    own = type(f"Own{name}", (type(task),), {"__module__": __name__})
    kept = {item.name: getattr(task, item.name) for item in fields(task) if item.init}
    changed = kept | {item: 1.3 * kept[item] for item in levels.numbers_of(task)}
    draw = np.random.default_rng(3)
    for values in (kept, changed):
        ours, theirs = (
            levels.build_levels(robot, Hierarchy([kind(**values)]), 0.005).function
            for kind in (type(task), own)
        )
        assert len({ours.n_in(), theirs.n_in()}) == 1
        inputs = [draw.normal(size=ours.size_in(k)) for k in range(ours.n_in())]
        inputs[0] = robot.configuration(
            position=(0.1, 0.2, -3.0), rpy=(0.1, 0.2, 0.3), joints=-0.1 - 0.05 * np.arange(7)
        )
        inputs[-1] = np.ones(1)
        for one, other in zip(ours(*inputs), theirs(*inputs), strict=True):
            np.testing.assert_allclose(np.array(one), np.array(other), rtol=1e-12, atol=1e-12)
    assert levels.numbers_of(own(**kept)) == []
