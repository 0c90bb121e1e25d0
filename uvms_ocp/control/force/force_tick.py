"""A tick of the force layer in numbers: its functions, compiled, and the memory that they work on."""

from __future__ import annotations

from dataclasses import replace
from typing import Generic, TypeVar

import numpy as np

from uvms_ocp.control.actuator_health.effect import Effect
from uvms_ocp.control.force.allocation import allocation_of
from uvms_ocp.control.force.tick_columns import Allocated, Given, Known, Told, Wanted, parts_of, places_of, size_of
from uvms_ocp.control.force.tick_functions import (
    TickLaws,
    effect_sizes,
    follow_function,
    observe_function,
    want_function,
)
from uvms_ocp.functions.buffered import BoundFunction
from uvms_ocp.functions.compile import compile_function
from uvms_ocp.model.state import Command

_Parts = TypeVar("_Parts")


class _Column(Generic[_Parts]):
    """Numbers, and views of their parts."""

    __slots__ = ("numbers", "parts")

    def __init__(self, kind: type[_Parts], sizes: dict[str, int]) -> None:
        self.numbers = np.zeros(size_of(kind, sizes))
        self.parts = parts_of(kind, sizes, self.numbers)


class ForceTick:
    """From a reference velocity to commands, in four calls: `observe`, `want`, `allocate`, `follow`.

    Holds what is known: build one per run. Not for use from two threads at once.
    """

    def __init__(self, laws: TickLaws) -> None:
        sizes = laws.sizes
        self._whole = allocation_of(laws.robot)
        self._allocation = self._whole
        self._given, self._wanted = _Column(Given, sizes), _Column(Wanted, sizes)
        self._known, self._now = _Column(Known, sizes), _Column(Known, sizes)
        self._allocated, self._told = _Column(Allocated, sizes), _Column(Told, sizes)
        self._effect = _Column(Effect, effect_sizes(sizes))
        self._effect.parts.share[:] = self._known.parts.share[:] = 1.0
        self.now: Known = self._now.parts
        """What is known since `observe`; it may be changed before `want`."""
        columns = self._given, self._effect, self._known, self._now, self._wanted, self._allocated, self._told
        given, effect, known, now, wanted, allocated, told = (column.numbers for column in columns)
        self._observe = BoundFunction(compile_function(observe_function(laws)), [given, effect, known], [now])
        self._want = BoundFunction(compile_function(want_function(laws)), [given, now], [wanted])
        self._follow = BoundFunction(
            compile_function(follow_function(laws)), [given, effect, now, wanted, allocated], [known, told]
        )
        self._places = tuple(places_of(Told, sizes).values())

    def observe(
        self, q: np.ndarray, v: np.ndarray, command: Command, feedback: tuple[float, float], joints: bool
    ) -> None:
        """Find what pushes the robot at q (n_q,) [m, rad] and v (n_v,) [m/s, rad/s] as measured.

        command: of the velocities. feedback [-]: of vehicle and joints, it and joints as `Given` has them.
        """
        given = self._given.parts
        given.q[:], given.v[:], given.reference[:] = q, v, command.v
        given.feedback[0], given.joint_feedback[0] = feedback
        given.hold[0], given.stop[0], given.joints[0] = command.hold, command.stop, joints
        self._observe.evaluate()

    def want(self) -> None:
        """Find the force for the reference velocity."""
        self._want.evaluate()

    def allocate(self) -> bool:
        """Share it out among thrusters; whether their limits keep them from it. Raises `InvalidInput` unless it is finite."""
        found, result = self._allocated.parts, self._allocation.allocate(self._wanted.parts.wrench)
        found.thrust[:], found.reached[:], found.unreachable[:] = result.thrust, result.reached, result.unreachable
        return result.saturated

    def follow(self) -> list[np.ndarray]:
        """The parts of `Told`, which the caller owns; what is known is that of the next tick from now on."""
        self._follow.evaluate()
        told = self._told.numbers.copy()
        return [told[place] for place in self._places]

    def adapt(self, effect: Effect) -> None:
        """From now on: what thrusters make of their commands. What they failed to give has been taken for water so far."""
        n, old = len(self._told.parts.vehicle_force), self._effect.parts
        lost = self._whole.matrix @ (old.given(self.now.thrust) - effect.given(self.now.thrust))
        self.now.estimate[:n] += lost[:n]
        old.share[:], old.constant[:] = effect.share, effect.constant
        self._allocation = replace(
            self._whole, effect=Effect(share=effect.share.copy(), constant=effect.constant.copy())
        )
