"""A control period of the physical plant: several steps as one function, called through memory that is written to in place."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.functions.buffered import BoundFunction
from uvms_ocp.sim.dynamic_step import CARRIED


def period_function(step: ca.Function, n_steps: int) -> ca.Function:
    """``n_steps`` calls of `step_function` as one Function, whose dt [s] is that of all of them and whose result is one column.

    The column holds q, v, thrust, thruster_energy and joint_energy at the end, then torque and contact of the last step, then
    a (n_v,) [m/s2, rad/s2]: the mean acceleration, as an accelerometer would integrate it. n_steps [-] is at least 1. The
    graph is walked by CasADi; what takes time is the step, compiled once for periods of any length.
    """
    inputs = {step.name_in(i): ca.MX.sym(step.name_in(i), *step.size_in(i)) for i in range(step.n_in())}
    carried, held = list(inputs.values())[: len(CARRIED)], list(inputs.values())[len(CARRIED) :]
    dt = held.pop()
    results: list[ca.MX] = []
    for _ in range(n_steps):
        results = list(step(*carried, *held, dt / n_steps))
        carried = results[: len(CARRIED)]
    a = (carried[1] - inputs["v"]) / dt
    return ca.Function("plant_period", [*inputs.values()], [ca.vertcat(*results, a)], [*inputs], ["after"])


class StepSequence:
    """`period_function` over fixed memory: `given` is written to, and a call gives a fresh result.

    Not for use from two threads at once.
    """

    __slots__ = ("_period", "_result", "carried", "given")

    def __init__(self, step: ca.Function, n_steps: int) -> None:
        """step: `step_function`, compiled or not. n_steps [-]: at least 1, in a period. Raises `InvalidInput` for fewer."""
        if n_steps < 1:
            raise InvalidInput(f"{n_steps} steps in a period; give 1 or more")
        function = period_function(step, n_steps)
        memory, self.given = _memory(function)
        """By name: (n,) views, and those of a matrix as (columns, rows), all to be written to."""
        self.carried = memory[: parts_of(step)["torque"].start]
        """(n_carried,) view of the inputs that the first results are: for the next period."""
        self._result = np.zeros(function.numel_out(0))
        self._period = BoundFunction(function, [view.T for view in self.given.values()], [self._result])

    def __call__(self) -> np.ndarray:
        """The column (n,) [units of its parts] after one period of what is `given`."""
        self._period.evaluate()
        return self._result.copy()


def parts_of(step: ca.Function) -> dict[str, slice]:
    """Where each result of `period_function` stands in its column, by name."""
    names = [step.name_out(i).removesuffix("_next") for i in range(step.n_out())] + ["a"]
    ends = np.cumsum([*(step.numel_out(i) for i in range(step.n_out())), step.numel_out("v_next")]).tolist()
    return {name: slice(begin, end) for name, begin, end in zip(names, [0, *ends], ends, strict=False)}


def _memory(function: ca.Function) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
    """One block for all inputs and, by name, the views of it."""
    sizes = [function.size_in(i) for i in range(function.n_in())]
    ends = np.cumsum([rows * columns for rows, columns in sizes]).tolist()
    block, views = np.zeros(ends[-1]), {}
    for i, (rows, columns) in enumerate(sizes):
        part = block[ends[i] - rows * columns : ends[i]]
        views[function.name_in(i)] = part if columns == 1 else part.reshape(columns, rows)  # CasADi reads by columns
    return block, views
