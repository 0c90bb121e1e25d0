"""What makes the parts of one scenario's runs: `scenario.controller()`, `scenario.estimator()`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from uvms_ocp.control.force.dynamic import DynamicController
from uvms_ocp.control.navigation.health.guarded_estimator import GuardedEstimator
from uvms_ocp.control.navigation.health.monitor import HealthMonitor
from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.control.watched import WatchedController
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.sensing import SensorSpecs
from uvms_ocp.model.state import Command, Measurement
from uvms_ocp.parts.given import part_name
from uvms_ocp.parts.watched_estimator import watched_estimator

_OURS = (KinematicController, DynamicController)


class MissionController(Protocol):
    """What controls a run."""

    @property
    def kinematic(self) -> KinematicController:
        """The layer that knows the mission, its events and its quantities."""

    def __call__(self, measurement: Measurement, t: float) -> Command:
        """The command for the tick at time t [s]."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ControllerOf:
    """What makes the controllers of one scenario."""

    maker: Callable[..., Any]
    """Of any scenario's."""
    scenario: Any = field(repr=False)

    def __call__(self) -> MissionController:
        """A fresh one. Raises `InvalidInput` where the maker makes no callable."""
        made, scenario = self.maker(self.scenario), self.scenario
        if type(made) in _OURS:
            return made
        if not callable(made):
            raise InvalidInput(f"controller made {type(made).__name__}; make a callable (Measurement, t) -> Command")
        n = len(scenario.robot.description.thrusters) if scenario.takes_forces else None
        kinematic = scenario.kinematic_controller()
        return WatchedController(controller=made, kinematic=kinematic, n_thrusters=n, name=part_name(self.maker))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class EstimatorOf:
    """What makes the estimators of one scenario."""

    maker: Callable[..., Any]
    """Of any scenario's."""
    scenario: Any = field(repr=False)

    def __call__(self) -> GuardedEstimator:
        """A fresh one, ``(Readings, t, Command | None) -> Measurement``; a monitor keeps from it what cannot be true.

        Raises `InvalidInput` where the maker makes no callable.
        """
        made, scenario = self.maker(self.scenario), self.scenario
        robot, specs = scenario.robot, scenario.specs
        if not callable(made):
            allowed = "make a callable (Readings, t, command) -> Measurement"
            raise InvalidInput(f"estimator made {type(made).__name__}; {allowed}")
        monitor = HealthMonitor(robot, specs, altimeter_frame=scenario.altimeter_frame)
        return GuardedEstimator(watched_estimator(made, robot, part_name(self.maker)), robot, specs, monitor)


def maker_of(what: str, given: Any) -> Callable[..., Any]:
    """What was given for a part, also to the scenario that a changed one is made of. Raises `InvalidInput`."""
    if isinstance(given, ControllerOf | EstimatorOf):
        return given.maker
    if not callable(given):
        raise InvalidInput(f"{what} = {given!r}; give a callable that takes the scenario and makes one")
    return given


def own_names(parts: Mapping[str, Any], ours: tuple[Callable[..., Any], ...]) -> dict[str, str]:
    """Names of those parts of a scenario that are not the toolkit's, which are values or made by `ours`."""
    makers = {what: maker_of(what, part) for what, part in parts.items() if not isinstance(part, str | SensorSpecs)}
    return {what: part_name(maker) for what, maker in makers.items() if maker not in ours}
