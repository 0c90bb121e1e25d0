"""A thruster described from its other side, with direction and limits reversed, is the same one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import uvms_ocp as uo
from uvms_ocp.robot.description import Thruster, checked_copy
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.thrusters import (
    largest_force,
    largest_wrench,
    thrust_limits,
    thruster_matrix,
)
from uvms_ocp.scenario import reach

_LIMITS = {"both ways": (-30.0, 51.5), "one way": (0.0, 51.5)}
_REVERSED = {
    "all": lambda _: True,
    "those of heave": lambda thruster: abs(thruster.direction[2]) > 0.5,
    "every other one": lambda thruster: int(thruster.name[-1]) % 2 == 0,
}


def _changed(thruster: Thruster, **changes: object) -> Thruster:
    return Thruster.model_validate(dict(thruster) | changes)


def _limited(thruster: Thruster, limits: tuple[float, float]) -> Thruster:
    lower, upper = limits
    return _changed(thruster, minimum=lower, maximum=upper, dead_zone=0.5, curve=())


def _from_behind(thruster: Thruster) -> Thruster:
    direction = tuple(-component for component in thruster.direction)
    return _changed(
        thruster, direction=direction, minimum=-thruster.maximum, maximum=-thruster.minimum
    )


def _robots(limits: str, reversed_thrusters: str) -> tuple[Robot, Robot, np.ndarray]:
    """The robot, the same one with some thrusters described from behind, and the signs
    (n_thrusters,) by which their thrusts differ.
    """
    shipped = uo.load_robot("bluerov2_alpha5")
    thrusters = [_limited(thruster, _LIMITS[limits]) for thruster in shipped.description.thrusters]
    is_reversed = [_REVERSED[reversed_thrusters](thruster) for thruster in thrusters]
    mirrored = [
        _from_behind(thruster) if is_behind else thruster
        for thruster, is_behind in zip(thrusters, is_reversed, strict=True)
    ]
    robot, same = (
        replace(shipped, description=checked_copy(shipped.description, thrusters=tuple(listed)))
        for listed in (thrusters, mirrored)
    )
    return robot, same, np.where(is_reversed, -1.0, 1.0)


@pytest.mark.parametrize("reversed_thrusters", _REVERSED)
@pytest.mark.parametrize("limits", _LIMITS)
def test_what_thrusters_can_give_at_most_is_the_same(limits: str, reversed_thrusters: str) -> None:
    robot, same, _ = _robots(limits, reversed_thrusters)
    columns = thruster_matrix(robot)
    lower, upper = thrust_limits(robot)
    ahead = np.where(columns > 0.0, columns * upper, columns * lower).sum(axis=1)
    astern = np.where(columns > 0.0, columns * lower, columns * upper).sum(axis=1)
    for described in (robot, same):
        assert largest_wrench(described) == pytest.approx(ahead, abs=1e-4)
        force = largest_force(described)[:6]
        assert force == pytest.approx(np.maximum(ahead, -astern), abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("limits", "reversed_thrusters"), [("both ways", "every other one"), ("one way", "all")]
)
def test_the_run_is_the_same(limits: str, reversed_thrusters: str) -> None:
    robot, same, signs = _robots(limits, reversed_thrusters)
    current = uo.UniformCurrent([0.1, 0.05, 0.25])
    records = [
        reach(robot=described, duration=6.0, current=current, seed=3).run()
        for described in (robot, same)
    ]
    as_is, from_behind = records
    assert [str(event) for event in from_behind.meta.events] == [
        str(event) for event in as_is.meta.events
    ]
    assert from_behind["q"] == pytest.approx(as_is["q"], abs=1e-9)
    assert from_behind["thrust"] * signs == pytest.approx(as_is["thrust"], abs=1e-6)
