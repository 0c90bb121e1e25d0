"""What thrusters can still reach: the largest force along each axis while the others keep their balance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.control.actuator_health.effect import Effect

AXES = ("surge", "sway", "heave", "roll", "pitch", "yaw")
_GONE = 0.02  # share of the reach of sound thrusters that counts as none
_LEAST = 0.05  # share that a mission needs on the axes that nothing else holds
_HELD_BY_WATER = (3, 4)  # roll and pitch, where the righting moment may do


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Authority:
    """Along each axis of B, from the wrench that holds the robot still."""

    reach: np.ndarray
    """(6, 2) [N, N m] largest additional force down and up the axis, the other axes balanced; NaN where it cannot even hold."""
    sound: np.ndarray
    """(6, 2) [N, N m] the same of sound thrusters."""

    @property
    def holds(self) -> bool:
        """Whether the robot can be held still."""
        return bool(np.isfinite(self.reach).all())

    @property
    def lost(self) -> tuple[str, ...]:
        """Axes along which there is no force of its own either way any more."""
        return tuple(axis for axis, gone in zip(AXES, self._gone(), strict=True) if gone.all())

    @property
    def one_sided(self) -> tuple[str, ...]:
        """Axes along which there is force one way only."""
        return tuple(axis for axis, gone in zip(AXES, self._gone(), strict=True) if gone.any() and not gone.all())

    @property
    def can_go_on(self) -> bool:
        """Whether the robot can be held still and pushed either way on every axis that the water does not hold."""
        needed = [axis for axis in range(6) if axis not in _HELD_BY_WATER]
        return self.holds and bool((self.reach[needed] >= _LEAST * self.sound[needed]).all())

    def __str__(self) -> str:
        """What is left, in one line."""
        if not self.holds:
            return "the thrusters that are left cannot hold the robot still"
        parts = [f"{axis} can no longer be driven on its own" for axis in self.lost]
        parts += [f"{axis} can be driven one way only" for axis in self.one_sided]
        shares = self._shares()
        parts += [
            f"{axis} {100 * share:.0f} %"
            for axis, share in zip(AXES, shares, strict=True)
            if axis not in (*self.lost, *self.one_sided) and share < 0.95
        ]
        return f"left of the reach: {', '.join(parts)}" if parts else "nothing is out of reach"

    def _gone(self) -> np.ndarray:
        """(6, 2) which of what sound thrusters reach is out of reach."""
        there = self.sound > _GONE * self.sound.max()
        return there & ~(self.reach > _GONE * self.sound)

    def _shares(self) -> np.ndarray:
        """(6,) [-] of the reach of sound thrusters, the worse way."""
        return np.min(self.reach / np.maximum(self.sound, np.finfo(float).tiny), axis=1)


def authority_of(
    matrix: np.ndarray, lower: np.ndarray, upper: np.ndarray, effect: Effect, trim: np.ndarray, righting: np.ndarray
) -> Authority:
    """What is left with an effect, for a robot that trim (6,) [N, N m] holds still.

    matrix (6, n) [N/N, N m/N]; lower, upper (n,) [N] limits of what may be asked. righting (6,) [N, N m]: what the water
    balances on its own, within the tilt that is allowed. Twenty-four linear programs.
    """
    n = len(lower)
    reach = _reach(matrix, *effect.limits(lower, upper), trim, righting)
    sound = _reach(matrix, *Effect.sound(n).limits(lower, upper), np.zeros(6), righting)
    return Authority(reach=reach, sound=sound)


def _reach(
    matrix: np.ndarray, lower: np.ndarray, upper: np.ndarray, trim: np.ndarray, righting: np.ndarray
) -> np.ndarray:
    return np.array(
        [[_largest(matrix, lower, upper, trim, righting, axis, way) for way in (-1, 1)] for axis in range(6)]
    )


def _largest(
    matrix: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    trim: np.ndarray,
    righting: np.ndarray,
    axis: int,
    way: int,
) -> float:
    """Largest x with ``matrix T + s = trim + way x e``, T within its limits, s within what the water balances."""
    from scipy.optimize import linprog  # half a second, which few need

    direction = np.zeros((6, 1))
    direction[axis] = -way
    if axis in _HELD_BY_WATER:  # of the thrusters' own, whatever the water balances
        trim, righting = trim.copy(), righting.copy()
        trim[axis] = righting[axis] = 0.0
    bounds = [*zip(lower, upper, strict=True), *((-r, r) for r in righting), (0.0, None)]
    result = linprog(
        c=np.concatenate([np.zeros(len(lower) + 6), [-1.0]]),
        A_eq=np.hstack([matrix, np.eye(6), direction]),
        b_eq=trim,
        bounds=bounds,
        method="highs",
    )
    return float(-result.fun) if result.success else float("nan")
