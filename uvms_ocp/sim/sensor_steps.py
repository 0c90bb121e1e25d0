"""The sensors' part of a tick: readings of the true state. Sensors of the toolkit are kernels, those
of a user are asked.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from uvms_ocp.codegen.kernel_layout import view
from uvms_ocp.codegen.kernels import bind_kernels
from uvms_ocp.codegen.sequence import Source, Step
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation.health.channel_state import HealthMemory
from uvms_ocp.estimation.health.monitor import HealthMonitor
from uvms_ocp.robot.signals import Readings, State
from uvms_ocp.sim import loop_kernels as kernels
from uvms_ocp.sim.plant_steps import PlantSteps
from uvms_ocp.sim.sensors import SensorSuite


class SensorSteps(Protocol):
    """The sensors of a run, as steps of its ticks."""

    def steps(self) -> list[Step]:
        """Return the steps."""

    def begin(self, n_ticks: int) -> None:
        """Prepare for at most so many ticks, at most `uvms_ocp.sim.sampling.N_DRAWN`."""

    def check(self) -> None:
        """Raise what was raised as kernels asked Python, and what is wrong with the sensors."""

    def readings(self) -> Readings:
        """Return the newest reading of every channel; to be asked at every tick."""


class KernelSensors:
    """Sensors of the toolkit, whose readings go to the monitor as kernels."""

    def __init__(
        self,
        loop: kernels.LoopMemory,
        suite: SensorSuite,
        health: HealthMemory,
    ) -> None:
        self._loop = loop
        self._suite = suite
        self._health = health

    def steps(self) -> list[Step]:
        memories = (self._loop, self._suite.memory, self._health)
        (sense,) = bind_kernels((kernels.sense,), map(type, memories))
        return [Step("sense", sense, memories)]

    def begin(self, n_ticks: int) -> None:
        self._suite.draw_ahead(n_ticks)

    def check(self) -> None:
        self._suite.check()

    def readings(self) -> Readings:
        return self._suite.latest()


class OwnSensors:
    """Sensors of a user, which are asked."""

    def __init__(
        self,
        loop: kernels.LoopMemory,
        read: Callable[[State, float], Readings],
        plant: PlantSteps,
        monitor: HealthMonitor | None,
    ) -> None:
        """read: the sensors. plant: what they read. monitor: one whose kernels screen the
        readings; `None` where nobody does.
        """
        self._loop = loop
        self._read = read
        self._plant = plant
        self._monitor = monitor
        self._readings = Readings()

    def steps(self) -> list[Step]:
        return [Step("sense", self._sense)]

    def begin(self, n_ticks: int) -> None:
        pass

    def check(self) -> None:
        pass

    def readings(self) -> Readings:
        return self._readings

    def _sense(self) -> None:
        self._readings = self._read(self._plant.state(), self._loop.t)
        if self._monitor is not None:
            self._monitor.take_in(self._readings)


def readings_in_memory(
    loop: kernels.LoopMemory, monitor: HealthMonitor, kept_readings: Mapping[str, int]
) -> dict[str, Source]:
    """Return the series of new readings, which kernels write. Raises `InvalidInput` for other
    numbers than a channel has.
    """
    measured = view(loop.measured)
    sources = dict[str, Source]()
    for name, n in kept_readings.items():
        number = monitor.numbers[name]
        channel = monitor.memory.channels[number]
        if not channel.present:
            raise InvalidInput(f"{name} is to be kept, and there is no such sensor; leave it out")
        size = channel.size
        if size != n:
            raise InvalidInput(f"{name} has {size} numbers, {n} are to be kept of it")
        sources[f"measured_{name}"] = measured[number, : n + 1]
    return sources
