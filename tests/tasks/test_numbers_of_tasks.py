"""Real numbers of tasks are symbols in the levels, which are the same whatever stands in their
place.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import ClassVar

import casadi as ca
import numpy as np
import pytest
from task_registry import REGISTRY

from uvms_ocp.control.velocity import levels
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import load_robot
from uvms_ocp.tasks import Hierarchy, Rows, Task, TaskClass, determined_by_goal, equality_rows
from uvms_ocp.tasks.task import TickSymbols


@pytest.mark.sampled
@pytest.mark.parametrize(
    "name", [name for name in REGISTRY if levels.numbers_of(REGISTRY[name].task)]
)
def test_levels_of_symbols_are_those_of_numbers(name: str) -> None:
    """Of a class of a user's own the numbers stay numbers."""
    robot = load_robot("girona_maris7_full")
    task = REGISTRY[name].task
    user_class = type(f"Own{name}", (type(task),), {"__module__": __name__})
    values_of_task = {item.name: getattr(task, item.name) for item in fields(task) if item.init}
    changed = values_of_task | {
        item: 1.3 * values_of_task[item] for item in levels.numbers_of(task)
    }
    draw = np.random.default_rng(3)
    for values in (values_of_task, changed):
        ours, theirs = (
            levels.build_levels(robot, Hierarchy([kind(**values)]), 0.005).function
            for kind in (type(task), user_class)
        )
        assert len({ours.n_in(), theirs.n_in()}) == 1
        inputs = [draw.normal(size=ours.size_in(k)) for k in range(ours.n_in())]
        inputs[0] = robot.configuration(
            position=(0.1, 0.2, -3.0), rpy=(0.1, 0.2, 0.3), joints=-0.1 - 0.05 * np.arange(7)
        )
        inputs[-1] = np.ones(1)
        for ours_out, theirs_out in zip(ours(*inputs), theirs(*inputs), strict=True):
            np.testing.assert_allclose(
                np.array(ours_out), np.array(theirs_out), rtol=1e-12, atol=1e-12
            )
    assert levels.numbers_of(user_class(**values_of_task)) == []


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rise(Task):
    """Of a user: the vehicle rises towards a height."""

    symbolic_numbers: ClassVar[tuple[str, ...]] = ("gain",)
    name: str = "RI"
    task_class: TaskClass = TaskClass.ACTION
    goal: float = -1.0
    gain: float = 0.5

    def n_parameters(self, robot: object) -> int:
        return 1

    @determined_by_goal
    def reference(self, t: float) -> np.ndarray:
        return np.array([self.goal])

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        J = symbols.kinematics.jacobian("base_link")[2, :]
        return equality_rows(J, self.gain * (parameters - symbols.q[2]))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CarefulRise(Rise):
    """Of a user, made of one that declares its numbers: its own rows want numbers."""

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        rows = Rise.rows(self, symbols, parameters)
        return replace(rows, rate=rows.rate * float(self.gain))

    def reference(self, t: float) -> np.ndarray:
        return np.array([self.goal - t])


def test_a_class_of_a_users_own_declares_what_its_rows_and_its_reference_depend_on() -> None:
    robot = load_robot("bluerov2")

    def levels_of(task: Task) -> levels.LevelsProblem:
        return levels.build_levels(robot, Hierarchy([task]), 0.005)

    task = Rise()
    assert levels.numbers_of(task) == ["gain"]
    assert levels_of(task) is levels_of(replace(task, goal=-2.0))
    assert levels_of(task) is not levels_of(replace(task, gain=0.7))
    assert task.is_constant
    careful = CarefulRise()
    assert levels.numbers_of(careful) == []
    assert levels_of(careful) is not levels_of(careful)
    assert not careful.is_constant


@pytest.mark.parametrize("name", ["speed", "goal"])
def test_declared_numbers_that_are_none_are_refused(name: str) -> None:
    class Wrong(Rise):
        symbolic_numbers: ClassVar[tuple[str, ...]] = (name,)

    task = Wrong(goal=np.zeros(2))  # type: ignore[arg-type]
    with pytest.raises(InvalidInput, match=f"^RI: symbolic_numbers of Wrong has '{name}', which"):
        levels.build_levels(load_robot("bluerov2"), Hierarchy([task]), 0.005)
