"""A call without an argument that it needs says which, and methods of a base are looked at like those
of the class itself.
"""

from __future__ import annotations

import inspect
from pathlib import Path

import numpy as np
import pytest
from public_surface import Call, inherited_methods, surface
from valid_calls import STARRED, owner_of

from uvms_ocp import identification
from uvms_ocp.checks import checked_on_failure
from uvms_ocp.errors import ArgumentMissing, InvalidInput, UvmsError
from uvms_ocp.mission import Below
from uvms_ocp.reference.cited_names import exported_names
from uvms_ocp.sim import FlatSeafloor, UniformCurrent
from uvms_ocp.solvers import Icat, LexicographicActiveSet, LexicographicQp

SOLVERS = (LexicographicActiveSet, LexicographicQp, Icat)
WITH_REQUIRED = [
    call
    for call in surface()
    if any(
        parameter.default is parameter.empty and parameter.kind not in STARRED
        for parameter in call.parameters.values()
    )
]


@pytest.mark.parametrize("call", WITH_REQUIRED, ids=lambda call: call.title)
def test_a_call_without_arguments_names_the_first_that_it_needs(call: Call) -> None:
    function = call.function
    if call.owner is not None:
        function = getattr(owner_of(call), function.__name__)
    with pytest.raises(UvmsError, match=" is missing; give "):
        function()


@pytest.mark.parametrize("name", exported_names(Path(identification.__file__)))
def test_functions_of_identification_name_what_is_missing_or_wrong(name: str) -> None:
    function = getattr(identification, name)
    if not inspect.isfunction(function):
        return
    parameters = inspect.signature(inspect.unwrap(function)).parameters.values()
    required = [item.name for item in parameters if item.default is item.empty]
    with pytest.raises(ArgumentMissing, match=f"{required[0]} is missing; give "):
        function()
    wrong = {name: object() for name in required}
    with pytest.raises(InvalidInput, match=f": {required[0]} = <object"):
        function(**wrong)


def test_methods_of_a_base_look_at_their_arguments() -> None:
    unchecked = [
        title for title, method in inherited_methods() if not hasattr(method, "__wrapped__")
    ]
    assert not unchecked


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_solver_asks_for_levels(solver: type) -> None:
    with pytest.raises(ArgumentMissing, match=r"\.solve: levels is missing; give a sequence"):
        solver().solve()
    with pytest.raises(InvalidInput, match=r"\.solve: levels = 3; give a sequence"):
        solver().solve(3)
    with pytest.raises(InvalidInput, match="levels is empty; give at least one Level"):
        solver().solve([])


def test_what_runs_at_every_tick_names_an_argument_that_it_does_not_get() -> None:
    with pytest.raises(
        ArgumentMissing, match=r"^UniformField.velocity: p_W is missing; give an array"
    ):
        UniformCurrent([0.1, 0.0, 0.0]).velocity(t=0.0)
    with pytest.raises(
        ArgumentMissing, match=r"^UniformField.velocity: t is missing; give a number"
    ):
        UniformCurrent([0.1, 0.0, 0.0]).velocity(np.zeros((1, 3)))


def test_an_argument_that_is_not_read_is_missed_too() -> None:
    @checked_on_failure
    def constant(tree: dict[str, int], *, leaf: list[str]) -> int:
        return 1

    assert constant({}, leaf=[]) == 1
    with pytest.raises(ArgumentMissing, match=r"constant: tree is missing"):
        constant(leaf=[])
    with pytest.raises(ArgumentMissing, match=r"constant: leaf is missing"):
        constant({})


def test_a_value_without_a_field_says_which_value() -> None:
    with pytest.raises(ArgumentMissing, match=r"^FlatSeafloor: z is missing; give a number$"):
        FlatSeafloor()
    with pytest.raises(TypeError, match=r"^Below: quantity is missing"):
        Below(limit=1.0)
