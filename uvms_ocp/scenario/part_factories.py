"""Makers of the parts that a scenario's runs have in common: controllers and estimators, the
toolkit's or a user's own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from uvms_ocp.control import DynamicController, external
from uvms_ocp.control.velocity.guide import Guide
from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation.estimator import Estimator, PassThrough
from uvms_ocp.estimation.health.guarded_estimator import GuardedEstimator
from uvms_ocp.estimation.health.monitor import HealthMonitor
from uvms_ocp.robot import IDEAL_SENSORS, Command, SensorSpecs, StateEstimate
from uvms_ocp.robot.dynamics import cached_dynamics
from uvms_ocp.sim import watched_estimator
from uvms_ocp.sim.loop import StateEstimator
from uvms_ocp.sim.own_parts import part_name

if TYPE_CHECKING:
    from uvms_ocp.scenario.scenario import Scenario

_TOOLKIT_CONTROLLERS = (KinematicController, DynamicController)


class MissionController(Protocol):
    """Controller of a run."""

    @property
    def kinematic(self) -> KinematicController:
        """Layer that knows the mission, its events and its quantities."""

    def __call__(self, estimate: StateEstimate, t: float) -> Command:
        """Return the command for the tick at time t [s]."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PartFactory:
    """Maker of a part, controller or estimator, for the runs of one scenario."""

    maker: Callable[..., Any]
    """Function of a scenario that builds the part."""
    scenario: Any = field(repr=False)
    """Scenario for whose runs it builds."""


class ControllerFactory(PartFactory):
    """Maker of the controllers of one scenario."""

    __slots__ = ()

    def __call__(self) -> MissionController:
        """Make a controller for one run.

        A user's own is watched by the mission. Raises `InvalidInput` where the maker makes no
        callable.
        """
        scenario = self.scenario
        controller = self.maker(scenario)
        if type(controller) in _TOOLKIT_CONTROLLERS:
            return controller
        if not callable(controller):
            raise InvalidInput(
                f"controller made {type(controller).__name__}; make a callable (StateEstimate, t)"
                " -> Command"
            )
        if scenario.takes_forces:
            n_thrusters = len(scenario.robot.description.thrusters)
        else:
            n_thrusters = None
        return external.SupervisedController(
            controller=controller,
            kinematic=scenario.kinematic_controller(),
            n_thrusters=n_thrusters,
            name=part_name(self.maker),
        )


class EstimatorFactory(PartFactory):
    """Maker of the estimators of one scenario."""

    __slots__ = ()

    def __call__(self) -> GuardedEstimator:
        """Make an estimator for one run, ``(Readings, t, Command | None) -> StateEstimate``.

        A monitor keeps readings from it that cannot be true. Raises `InvalidInput` where the maker
        makes no callable.
        """
        scenario = self.scenario
        estimator = self.maker(scenario)
        robot = scenario.robot
        specs = scenario.specs
        if not callable(estimator):
            allowed = "make a callable (Readings, t, command) -> StateEstimate"
            raise InvalidInput(f"estimator made {type(estimator).__name__}; {allowed}")
        monitor = HealthMonitor(robot, specs, altimeter_frame=scenario.altimeter_frame)
        watched = watched_estimator.watched_estimator(
            estimator, robot, part_name(self.maker), len(monitor.numbers)
        )
        return GuardedEstimator(watched, robot, specs, monitor)


def our_controller(
    scenario: Scenario, guide: Guide | None = None
) -> KinematicController | DynamicController:
    """Make the toolkit's controller for one run: the hierarchy, with thrust and torque unless the
    plant takes velocities alone.

    guide: stands in for the hierarchy while it lasts.
    """
    kinematic = scenario.kinematic_controller(guide)
    if not scenario.takes_forces:
        return kinematic
    return DynamicController(
        robot=scenario.robot,
        dynamics=cached_dynamics(scenario.robot),
        kinematic=kinematic,
        gains=scenario.gains,
        sensors=scenario.specs,
        load=scenario.load,
    )


def our_estimator(scenario: Scenario) -> StateEstimator:
    """Make the toolkit's filter for one run; readings of ideal sensors are passed on as they are."""
    if scenario.specs == IDEAL_SENSORS:
        return PassThrough(scenario.robot, scenario.specs)
    return Estimator(scenario.robot, scenario.specs, altimeter_frame=scenario.altimeter_frame)


def maker_of(part: str, argument: Any) -> Callable[..., Any]:
    """Return the maker of a part: the argument itself, or the maker in a `PartFactory`.

    Raises `InvalidInput` where it cannot be called.
    """
    if isinstance(argument, PartFactory):
        return argument.maker
    if not callable(argument):
        raise InvalidInput(
            f"{part} = {argument!r}; give a callable that takes the scenario and makes one"
        )
    return argument


def own_names(parts: Mapping[str, Any], ours: tuple[Callable[..., Any], ...]) -> dict[str, str]:
    """Return the names of those parts of a scenario that are a user's own, by kind of part.

    The toolkit's parts are values, such as the name of a plant, or made by one of `ours`.
    """
    names = {}
    for kind, part in parts.items():
        if isinstance(part, str | SensorSpecs):
            continue
        maker = maker_of(kind, part)
        if maker not in ours:
            names[kind] = part_name(maker)
    return names
