"""Frozen values share nothing that can be written to with who made them; they and all errors
survive pickling.
"""

from __future__ import annotations

import copy
import errno
import pickle
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import FrozenInstanceError
from typing import Any

import numpy as np
import pytest
from valid_calls import q, run_record, scenario, transition

from uvms_ocp import Phase, Record, Water, errors as exceptions
from uvms_ocp.checks import replace_unchecked, unchecked_constructor
from uvms_ocp.errors import InvalidInput, NameNotFound, OutputError, UvmsError
from uvms_ocp.robot.signals import Command, Reading, State, StateEstimate
from uvms_ocp.scenario.scenario import Scenario

ERRORS = [
    UvmsError("a", 2),
    InvalidInput("wrong"),
    NameNotFound("robot", "nautilus", ["girona"]),
    exceptions.FrameNotFound("tol", ["tool"]),
    exceptions.ArgumentNotFound("load_robot", "varient", ["variant"]),
    exceptions.ArgumentMissing("Icat.solve", "levels", "a sequence of which each is a Level"),
    exceptions.RobotDataError("robot.urdf", "broken"),
    OutputError("no room"),
    OutputError(errno.ENOSPC, "full", "record.npz"),
    exceptions.NotInstalled("a solver", "daqp"),
]
COPIES: list[Callable[[Any], Any]] = [
    lambda value: pickle.loads(pickle.dumps(value)),
    copy.copy,
    copy.deepcopy,
]


def test_the_list_of_errors_is_complete() -> None:
    classes = [value for value in vars(exceptions).values() if isinstance(value, type)]
    errors = {cls for cls in classes if issubclass(cls, UvmsError)}
    assert {type(error) for error in ERRORS} == errors


@pytest.mark.parametrize("again", COPIES, ids=["pickle", "copy", "deepcopy"])
@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_errors_survive(error: UvmsError, again: Callable[[Any], Any]) -> None:
    survivor = again(error)
    assert type(survivor) is type(error)
    assert (str(survivor), survivor.args, vars(survivor)) == (str(error), error.args, vars(error))
    if isinstance(error, OSError):
        assert (survivor.errno, survivor.filename) == (error.errno, error.filename)


@pytest.mark.parametrize(
    "error", [InvalidInput("two\nlines"), OutputError(errno.EACCES, "denied", "a\nb")]
)
def test_errors_are_one_line(error: UvmsError) -> None:
    assert "\n" not in str(error)


def mistyped(name: str) -> dict[str, Any]:
    raise NameNotFound("robot", name, ["girona"])


def test_a_mistyped_name_is_told_by_a_pool_of_processes() -> None:
    with (
        ProcessPoolExecutor(max_workers=1) as pool,
        pytest.raises(NameNotFound, match="unknown robot 'giorna'"),
    ):
        pool.submit(mistyped, "giorna").result()


def test_values_do_not_change_with_what_they_were_made_of() -> None:
    start = q()
    u = np.zeros(3)
    activations = {"HA": 1.0}
    t = np.arange(3.0)
    transitions = [transition()]
    options = {
        name: getattr(scenario(), name)
        for name in ("name", "robot", "mission", "environment", "plant", "solver")
    }
    own_scenario = Scenario(start=start, **options)
    water = Water(velocity=u, acceleration=u)
    phase = Phase(name="A", activations=activations, transitions=transitions)
    record = Record(series={"t": t}, meta=run_record().meta)
    start[0] = 1e3
    u[0] = 5.0
    activations["HA"] = 7.0
    t[0] = 9.0
    transitions.clear()
    assert own_scenario.start[0] != 1e3
    assert not water.velocity.any()
    assert not water.acceleration.any()
    assert phase.activations == {"HA": 1.0}
    assert phase.transitions == (transition(),)
    assert record["t"][0] == 0.0


def test_values_cannot_be_written_to() -> None:
    phase = Phase(name="A", activations={"HA": 1.0}, transitions=(transition(),))
    arrays = [
        scenario().start,
        Water(velocity=np.zeros(3)).velocity,
        run_record()["t"],
        Water().velocity,
    ]
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    for write in (
        lambda: phase.activations.update(HA=7.0),
        lambda: phase.activations.__setitem__("HA", 7.0),
    ):  # type: ignore[attr-defined]
        with pytest.raises(TypeError, match="frozen"):
            write()
    with pytest.raises(TypeError, match="frozen"):
        run_record().series["t"] = np.zeros(1)  # type: ignore[index]


@pytest.mark.parametrize("gate", [7.0, -0.1, float("nan")])
def test_gates_outside_of_0_to_1_are_refused(gate: float) -> None:
    with pytest.raises(InvalidInput, match="from 0 to 1"):
        Phase(name="A", activations={"HA": gate}, transitions=(transition(),))


@pytest.mark.parametrize("again", COPIES[::2], ids=["pickle", "deepcopy"])
def test_frozen_values_survive(again: Callable[[Any], Any]) -> None:
    phase = Phase(name="A", activations={"HA": 0.5}, transitions=(transition(),))
    record = run_record()
    assert again(phase).activations == phase.activations
    assert again(phase).transitions == phase.transitions
    np.testing.assert_array_equal(again(record)["q"], record["q"])
    np.testing.assert_array_equal(again(Water(velocity=np.ones(3))).velocity, np.ones(3))
    assert again(scenario().environment).seafloor == scenario().environment.seafloor


def test_values_of_a_tick_are_copies_to_users_and_as_they_are_to_the_loop() -> None:
    q, v = np.zeros(5), np.zeros(5)
    copied = State(q=q, v=v)
    uncopied = unchecked_constructor(State)(q=q, v=v)
    q[0] = 1.0
    assert copied.q[0] == 0.0
    assert uncopied.q is q
    assert type(uncopied) is State
    with pytest.raises(FrozenInstanceError):
        uncopied.q = q  # type: ignore[misc]
    with pytest.raises(FrozenInstanceError):
        del uncopied.q
    assert unchecked_constructor(Reading)(value=q, t=0.0).value is q
    assert unchecked_constructor(StateEstimate)(q=q, v=v, altimeter_range=1.0).age == 0.0
    assert (
        unchecked_constructor(Command)(v=v).telemetry
        is not unchecked_constructor(Command)(v=v).telemetry
    )
    with pytest.raises(TypeError, match="missing"):
        unchecked_constructor(State)(q=q)
    with pytest.raises(
        InvalidInput, match="give finite numbers"
    ):  # what a constructor does beyond storing is done
        unchecked_constructor(Water)(velocity=np.full(3, np.nan))


def test_what_is_changed_keeps_its_other_fields() -> None:
    command = Command(v=np.ones(5), hold=True)
    stopped = replace_unchecked(command, stop=True)
    assert (stopped.stop, stopped.hold, stopped.v is command.v, command.stop) == (
        True,
        True,
        True,
        False,
    )
