"""The sensors' part of a tick: readings of the true state. Sensors of the toolkit are kernels, those
of a user are asked.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from uvms_ocp.codegen.kernel_layout import view
from uvms_ocp.codegen.kernels import bind_kernels
from uvms_ocp.codegen.sequence import Source, Step
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation.filter_memory import NUMBER
from uvms_ocp.estimation.health.channel_state import HealthMemory
from uvms_ocp.estimation.health.monitor import HealthMonitor
from uvms_ocp.robot.signals import Reading, Readings, State
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

    def sources(self) -> dict[str, Source]:
        """Return the new readings of the channels that are kept, in memory."""


class KernelSensors:
    """Sensors of the toolkit, whose readings go to the monitor as kernels."""

    def __init__(
        self,
        loop: kernels.LoopMemory,
        suite: SensorSuite,
        health: HealthMemory,
        kept_readings: Mapping[str, int],
    ) -> None:
        """kept_readings: channels whose new readings are recorded, and how many numbers each has.
        Raises `InvalidInput` for other numbers than the channel has.
        """
        self._loop = loop
        self._suite = suite
        self._health = health
        self._kept_readings = kept_readings

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

    def sources(self) -> dict[str, Source]:
        return readings_in_memory(self._loop, self._health, self._kept_readings)


class OwnSensors:
    """Sensors of a user, which are asked."""

    def __init__(
        self,
        loop: kernels.LoopMemory,
        read: Callable[[State, float], Readings],
        plant: PlantSteps,
        kept_readings: Mapping[str, int],
        monitor: HealthMonitor | None,
    ) -> None:
        """read: the sensors. plant: what they read. kept_readings: channels whose new
        readings are recorded, and how many numbers each has. monitor: one whose kernels screen the
        readings.
        """
        self._loop = loop
        self._read = read
        self._plant = plant
        self._monitor = monitor
        self._kept = _NewReadings(kept_readings)
        self._readings = Readings()

    def steps(self) -> list[Step]:
        return [Step("sense", self._sense)]

    def begin(self, n_ticks: int) -> None:
        pass

    def check(self) -> None:
        pass

    def readings(self) -> Readings:
        return self._readings

    def sources(self) -> dict[str, Source]:
        return {**self._kept.arrays}

    def _sense(self) -> None:
        self._readings = self._read(self._plant.state(), self._loop.t)
        self._kept.write(self._readings)
        if self._monitor is not None:
            self._monitor.take_in(self._readings)


def readings_in_memory(
    loop: kernels.LoopMemory, health: HealthMemory, kept_readings: Mapping[str, int]
) -> dict[str, Source]:
    """Return the series of new readings, which kernels write. Raises `InvalidInput` for other
    numbers than a channel has.
    """
    measured = view(loop.measured)
    sources = dict[str, Source]()
    for name, n in kept_readings.items():
        require_kept(name, health.channels[NUMBER[name]].size, n)
        sources[f"measured_{name}"] = measured[NUMBER[name], : n + 1]
    return sources


class _NewReadings:
    """Readings that are new at a tick, each with when it was taken; NaN where none is."""

    __slots__ = ("_seen", "arrays")

    def __init__(self, sizes: Mapping[str, int]) -> None:
        self._seen: dict[str, Reading[Any] | None] = dict.fromkeys(sizes)
        self.arrays = {f"measured_{name}": np.full(n + 1, np.nan) for name, n in sizes.items()}

    def write(self, readings: Readings) -> None:
        for channel, seen in self._seen.items():
            reading = getattr(readings, channel)
            row = self.arrays[f"measured_{channel}"]
            # Also with the time of an earlier one, as clocks that fail give them.
            if reading is None or reading is seen:
                row[:] = np.nan
            else:
                self._seen[channel] = reading
                value = np.ravel(reading.value)
                require_kept(channel, value.size, row.size - 1)
                row[:-1] = value
                row[-1] = reading.t


def require_kept(name: str, size: int, n: int) -> None:
    """Raise `InvalidInput` unless so many numbers of a channel are to be kept as it has."""
    if size != n:
        raise InvalidInput(f"{name} has {size} numbers, {n} are to be kept of it")
