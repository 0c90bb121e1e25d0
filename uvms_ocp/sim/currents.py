"""Water currents: velocity fields over ground in W, with the derivatives that give the acceleration
of the water.
"""

from __future__ import annotations

import math
from dataclasses import field
from typing import Annotated, Any, Protocol, final

import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked_constructor, checked_dataclass, checked_on_failure, finite_array
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.hydrodynamics import Water
from uvms_ocp.types import DAY, Count, Finite, Positive, Shape

_FASTEST = 10.0  # [m/s] no sea is faster, Saltstraumen included: more is a slip of units
_BLOCK = 256  # nodes of a gust that are drawn at a time
_CATMULL_ROM = (
    np.array([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]]) / 2
)  # of powers, by nodes

Points = Annotated[np.ndarray, Shape("n", 3)]


class Current(Protocol):
    """A field of water velocity u. It is asked for u and both its derivatives; `water_at` joins
    them.

    A class with a `velocity` of its own is neither uniform nor steady until it states so itself,
    whatever it is made of.
    """

    __slots__ = ()

    def __init_subclass__(cls, **options: Any) -> None:
        """Reset `uniform_flow` and `is_steady` to those of `Current` in a class that overrides
        `velocity` and not these.
        """
        # A class made of `UniformCurrent` that overrides `velocity` alone would else be flown as
        # the uniform current that it no longer is, without a word. Stated here, it holds for every
        # class that users write, whoever asks, and costs a tick nothing.
        super().__init_subclass__(**options)
        if "velocity" not in vars(cls):
            return
        for name in ("uniform_flow", "is_steady"):
            if name not in vars(cls):
                setattr(cls, name, vars(Current)[name])

    @property
    def is_steady(self) -> bool:
        """True for one that is the same at all points and times."""
        return False

    def uniform_flow(self, t: float) -> np.ndarray | None:
        """Return velocity [m/s] and its rate [m/s2] (2, 3) in W at time t [s], `None` where they
        depend on the point.

        Raises `InvalidInput` where `velocity` does.
        """
        return None

    def velocity(self, p_W: Points, t: float) -> np.ndarray:
        """Return the velocity (n, 3) [m/s] in W at points p_W (n, 3) [m] and time t [s].

        Raises `InvalidInput` for a time that the field does not cover.
        """

    def rate(self, p_W: Points, t: float) -> np.ndarray:
        """Return ``du/dt`` (n, 3) [m/s2] in W at fixed points p_W (n, 3) [m] and time t [s].

        Raises `InvalidInput` where `velocity` does.
        """

    def gradient(self, p_W: Points, t: float) -> np.ndarray:
        """Return ``du_i/dx_j`` (n, 3, 3) [1/s] in W at points p_W (n, 3) [m] and time t [s].

        Raises `InvalidInput` where `velocity` does.
        """


@checked_on_failure
def water_at(current: Current, p_W: Points, t: float) -> Water:
    """Return the water at points p_W (n, 3) [m] and time t [s]: u and its own acceleration ``Du/Dt
    = du/dt + (u . grad) u``.

    That is how u changes for a particle of the water, not for a robot that moves through it:
    nothing where the water flows steadily in parallel layers. `uvms_ocp.robot.hydrodynamics` says
    what else slopes do, which is neglected. Raises `InvalidInput` where the current does.
    """
    u = current.velocity(p_W, t)
    return Water(
        velocity=u,
        acceleration=current.rate(p_W, t) + (current.gradient(p_W, t) @ u[:, :, None])[:, :, 0],
    )


@checked_on_failure
class UniformField(Current):
    """A current that is the same at all points: its `flow` says all of it."""

    __slots__ = ()

    def flow(self, t: float) -> np.ndarray:
        """Return velocity [m/s] and its rate [m/s2] (2, 3) in W at time t [s]."""
        raise NotImplementedError

    @final
    def uniform_flow(self, t: float) -> np.ndarray:
        # A class with a `velocity` of its own loses this method, and may still ask for the flow of
        # the class that it is made of by ``super().velocity(p_W, t)``.
        return self.flow(t)

    def velocity(self, p_W: Points, t: float) -> np.ndarray:
        velocity, _ = self.flow(t)
        return np.tile(velocity, (len(p_W), 1))

    def rate(self, p_W: Points, t: float) -> np.ndarray:
        _, rate = self.flow(t)
        return np.tile(rate, (len(p_W), 1))

    def gradient(self, p_W: Points, t: float) -> np.ndarray:
        return np.zeros((len(p_W), 3, 3))


@checked_dataclass(check=checked_on_failure)
class StillWater(UniformField):
    """Water without a current."""

    @property
    def is_steady(self) -> bool:
        return True

    def flow(self, t: float) -> np.ndarray:
        return np.zeros((2, 3))


@checked_dataclass(check=checked_on_failure, kw_only=False, eq=False)
class UniformCurrent(UniformField):
    """A velocity (3,) [m/s] that holds everywhere and always.

    Raises `InvalidInput` for a velocity that is not finite or faster than any sea.
    """

    value: np.ndarray
    """(3,) [m/s] velocity in W."""

    def __init__(self, velocity: ArrayLike) -> None:
        object.__setattr__(self, "value", _flow("velocity of the current", velocity, (3,)))

    @property
    def is_steady(self) -> bool:
        return True

    def flow(self, t: float) -> np.ndarray:
        return np.array([self.value, np.zeros(3)])


@checked_dataclass(check=checked_on_failure, eq=False)
class ShearedCurrent(Current):
    """A steady current that varies with depth: linear between the given heights, constant beyond
    them.

    Raises `InvalidInput` for heights that do not increase, or velocities that are not finite or
    faster than any sea.
    """

    z: np.ndarray
    """(k,) [m] heights in W, increasing."""
    velocities: np.ndarray
    """(k, 3) [m/s] in W at these heights."""

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "z", finite_array("z of a sheared current", self.z, (max(np.size(self.z), 1),))
        )
        if (np.diff(self.z) <= 0).any():
            raise InvalidInput(
                f"z of a sheared current = {self.z.tolist()} m; give increasing heights"
            )
        object.__setattr__(
            self,
            "velocities",
            _flow("velocities of a sheared current", self.velocities, (len(self.z), 3)),
        )

    @staticmethod
    def over_floor(velocity: ArrayLike, *, floor_z: float, thickness: Positive) -> ShearedCurrent:
        """Make the power law ``velocity (height / thickness)^(1/7)`` of a turbulent boundary layer,
        `velocity` (3,) [m/s] above it.

        floor_z [m] in W, thickness [m] of the layer. Raises `InvalidInput` for a thickness that is
        not > 0, and as the class does.
        """
        share = np.linspace(0.0, 1.0, 33) ** 3  # dense at the floor, where the profile is steep
        velocity = _flow("velocity of the current", velocity, (3,))
        return ShearedCurrent(
            z=floor_z + thickness * share, velocities=np.outer(share ** (1 / 7), velocity)
        )

    def velocity(self, p_W: Points, t: float) -> np.ndarray:
        return np.stack(
            [np.interp(p_W[:, 2], self.z, column) for column in self.velocities.T], axis=1
        )

    def rate(self, p_W: Points, t: float) -> np.ndarray:
        return np.zeros((len(p_W), 3))

    def gradient(self, p_W: Points, t: float) -> np.ndarray:
        beyond = np.zeros((1, 3))
        slopes = np.diff(self.velocities, axis=0) / np.diff(self.z)[:, None]
        layer = np.searchsorted(
            self.z, p_W[:, 2], side="right"
        )  # at one of the heights: the layer above
        gradient = np.zeros((len(p_W), 3, 3))
        gradient[:, :, 2] = np.vstack([beyond, slopes, beyond])[layer]
        return gradient


@checked_dataclass(check=checked_on_failure, kw_only=False, eq=False)
class OnsetCurrent(UniformField):
    """A uniform current that sets in: from rest to its velocity by a cosine step, as when the tide
    turns.
    """

    value: np.ndarray
    """(3,) [m/s] velocity in W after the onset."""
    start: float
    """[s] until which the water rests."""
    rise: float
    """[s] Time that the step takes."""

    def __init__(self, velocity: ArrayLike, *, start: Finite, rise: Positive) -> None:
        """velocity (3,) [m/s]: once the current has set in. start [s]: until which the water rests.
        rise [s]: time that the step takes.

        Raises `InvalidInput` for a velocity that is not finite or faster than any sea, and a rise
        that is not > 0.
        """
        object.__setattr__(self, "value", _flow("velocity of the current", velocity, (3,)))
        object.__setattr__(self, "start", float(start))
        object.__setattr__(self, "rise", float(rise))

    def flow(self, t: float) -> np.ndarray:
        return np.multiply.outer(self.growth(t), self.value)

    def growth(self, t: float) -> tuple[float, float]:
        """Return the share of the whole velocity that there is at time t [s], and its rate [1/s]."""
        share = (t - self.start) / self.rise
        return cosine_step(share), cosine_slope(share) / self.rise


def cosine_step(share: float) -> float:
    """Evaluate a cosine step from 0 at 0 to 1 at 1, level beyond both."""
    return 0.5 - 0.5 * math.cos(math.pi * min(max(share, 0.0), 1.0))


def cosine_slope(share: float) -> float:
    """Evaluate the derivative of `cosine_step`."""
    if 0.0 < share < 1.0:
        return 0.5 * math.pi * math.sin(math.pi * share)
    return 0.0


@checked_dataclass(check=checked_constructor, eq=False)
class GustyCurrent(Current):
    """Gusts on top of another current, the same everywhere: a first-order Gauss-Markov process.

    The process is drawn at nodes `step` apart and joined by cubics, so that velocity and rate are
    continuous. It is a pure function of t >= 0: nodes are drawn in order, whatever the order of calls,
    and kept. The base is not carried along by gusts, and water that gusts carry through it
    accelerates: sideways, where a vertical gust crosses the layers of a `ShearedCurrent`.

    Raises `InvalidInput` for a sigma below 0 or a time that is not > 0.
    """

    base: Current = field(default_factory=StillWater)
    """Current that the gusts come on top of."""
    sigma: float | tuple[float, float, float] = 0.05
    """[m/s] standard deviation, per axis of W if three are given."""
    correlation_time: Positive = 10.0
    """[s] time constant of the gusts: longer ones are slower."""
    step: Positive = 0.5
    """[s] between nodes."""
    seed: Count = 0
    """Seed of the random numbers."""
    _path: _Path = field(init=False, repr=False)
    """The nodes."""

    def __post_init__(self) -> None:
        sigma = np.array(self.sigma, dtype=float)
        if sigma.shape not in ((), (3,)) or not (np.isfinite(sigma).all() and (sigma >= 0).all()):
            raise InvalidInput(
                f"sigma of a gust = {self.sigma} m/s; give one or three finite numbers >= 0"
            )
        decay = math.exp(-self.step / self.correlation_time)
        object.__setattr__(self, "_path", _Path(np.broadcast_to(sigma, (3,)), decay, self.seed))

    def uniform_flow(self, t: float) -> np.ndarray | None:
        base = self.base.uniform_flow(t)
        if base is None:
            return None
        return base + self.gust(t)

    def velocity(self, p_W: Points, t: float) -> np.ndarray:
        return self.base.velocity(p_W, t) + self.gust(t)[0]

    def rate(self, p_W: Points, t: float) -> np.ndarray:
        return self.base.rate(p_W, t) + self.gust(t)[1]

    def gradient(self, p_W: Points, t: float) -> np.ndarray:
        return self.base.gradient(p_W, t)

    def gust(self, t: float) -> np.ndarray:
        """Return the velocity [m/s] of the gust alone and its rate [m/s2] (2, 3) at time t [s],
        from the two nodes on either side.

        Raises `InvalidInput` for a time before 0 or after a day.
        """
        if not 0 <= t <= DAY:
            raise InvalidInput(
                f"gust at t = {t} s; give a time from 0 to {DAY:g} s, a day: all before it is drawn"
            )
        k = int(t / self.step)
        h = self.step
        s = t / h - k
        values = (1.0, s, s * s, s * s * s)
        rates = (0.0, 1.0 / h, 2.0 * s / h, 3.0 * s * s / h)
        powers = np.array((values, rates))
        return powers.dot(_CATMULL_ROM).dot(self._path.nodes(k, k + 4))


class _Path:
    """Nodes of a stationary Gauss-Markov process, drawn in blocks when first asked for."""

    def __init__(self, sigma: np.ndarray, decay: float, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._decay = decay
        self._kick = sigma * math.sqrt(1 - decay**2)
        self._nodes = (sigma * self._rng.standard_normal(3))[None, :]

    def nodes(self, start: int, end: int) -> np.ndarray:
        """Return the nodes (end - start, 3) [m/s] from `start` to `end`."""
        while end > len(self._nodes):
            block = self._kick * self._rng.standard_normal((_BLOCK, 3))
            previous = self._nodes[-1]
            for row in block:
                row += self._decay * previous
                previous = row
            self._nodes = np.vstack([self._nodes, block])
        return self._nodes[start:end]


def _flow(what: str, values: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """Return velocities of the given shape (..., 3) [m/s]. Raises `InvalidInput` where they are not
    finite or faster than any sea.
    """
    array = finite_array(what, values, shape)
    scale = max(1.0, float(np.abs(array).max(initial=0.0)))  # so that squares are numbers
    speed = scale * float(np.linalg.norm(array / scale, axis=-1).max(initial=0.0))
    if speed > _FASTEST:
        raise InvalidInput(f"{what} reaches {speed:g} m/s; give at most {_FASTEST:g} m/s")
    return array
