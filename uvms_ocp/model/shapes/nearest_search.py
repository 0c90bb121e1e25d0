"""The pairs of shapes that come nearest on a way, from Python: in machine code as far as the shapes have a form in C."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uvms_ocp.functions.kernels.binding import memory_of
from uvms_ocp.functions.kernels.layout import structure_of, view
from uvms_ocp.model.shapes.collision_model import CollisionModel
from uvms_ocp.model.shapes.distance_kernels.nearest import (
    NearestMemory,
    choose_near,
    choose_nearest,
    measure_nearest,
    tell_closing,
)

_ENDLESS = 1e9  # [m] stands for a reach without end
_PLACES = 5  # [-] now and ahead


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Nearest:
    """What is found; valid until the next search."""

    smallest: float
    """[m] distance of all pairs now."""
    distance: np.ndarray
    """(n,) [m] smallest of each of the nearest pairs on the way."""
    closing: np.ndarray
    """(n,) [m/s] speed of approach whose stop just leaves the threshold."""
    gradient: np.ndarray
    """(n, n_v) [-, m] of each distance, where it is smallest."""


class NearestSearch:
    """For the n pairs of a model that come nearest. Not for two threads at once."""

    def __init__(self, model: CollisionModel, *, n: int, threshold: float, far: float) -> None:
        """n [-]: of all pairs at most. threshold [m]: by which they stay apart. far [m/s]: speed of what is nearest now."""
        sizes = model.memory_sizes() | {"n_q": model.n_q, "n_places": _PLACES, "n_rows": n}
        kernels = (measure_nearest, choose_near, choose_nearest, tell_closing)
        memory, (self._measure, self._near, self._nearest, self._closing) = memory_of(
            structure_of(NearestMemory, **sizes), kernels
        )
        self._model, self._memory = model, memory
        memory.n_pairs, memory.n_rows, memory.threshold, memory.far = model.n_pairs, n, threshold, far
        view(memory.reach)[:] = np.fmin(model.reach, _ENDLESS)
        self._whole = not model.by_coal and self._measure is not measure_nearest
        if self._whole:
            model.write(memory.distances)
        names = ("q", "duration", "velocity", "table", "near", "pair", "place", "distance", "closing", "gradient")
        self._arrays: dict[str, np.ndarray] = {name: view(getattr(memory, name)) for name in names}

    def __call__(
        self, q: np.ndarray, velocity: np.ndarray, durations: Sequence[float], ahead: Sequence[np.ndarray]
    ) -> Nearest:
        """From q (n_q,) [m, rad] with velocity (n_v,) [m/s, rad/s], past up to 4 `ahead` (n_q,) after `durations` [s]."""
        arrays, memory = self._arrays, self._memory
        memory.n_places = 1 + len(ahead)
        arrays["q"][0], arrays["velocity"][:] = q, velocity
        for k, place in enumerate(ahead):
            arrays["q"][k + 1], arrays["duration"][k + 1] = place, durations[k]
        if self._whole:
            self._measure(memory)
        else:
            self._step_by_step()
        distance, closing, gradient = (arrays[name] for name in ("distance", "closing", "gradient"))
        return Nearest(smallest=memory.smallest, distance=distance, closing=closing, gradient=gradient)

    def _step_by_step(self) -> None:
        arrays, memory, model = self._arrays, self._memory, self._model
        arrays["table"][0, : model.n_pairs] = model.values(arrays["q"][0])
        self._near(memory)
        near = arrays["near"][: memory.n_near]
        for place in range(1, memory.n_places):
            arrays["table"][place, near] = model.values(arrays["q"][place], near)
        self._nearest(memory)
        for place in set(arrays["place"].tolist()):
            rows = np.flatnonzero(arrays["place"] == place)
            arrays["gradient"][rows] = model.distances(arrays["q"][place], arrays["pair"][rows]).gradient
        self._closing(memory)
