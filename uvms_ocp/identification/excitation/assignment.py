"""What an excitation is to find out, and with which means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.identification.answers.numbers import slopes_of
from uvms_ocp.identification.excitation.confines import Limits
from uvms_ocp.identification.excitation.information import Aim
from uvms_ocp.identification.methods.output_error import Noise
from uvms_ocp.identification.models.stage import N_V, Vehicle

_SHORTEST, _LONGEST = 1.0, 1800.0  # [s]: maps from knots to commands grow with the square


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Assignment:
    """One. Raises InvalidInput for limits of other actuators, and too little time or too much."""

    vehicle: Vehicle
    """With its unknowns where they are believed to be."""
    limits: Limits
    duration: float = 60.0
    """[s] of a recording."""
    matter: tuple[str, ...] = ()
    """Numbers, or quantities, which are to be known well; all where none is named."""
    noise: Noise = field(default_factory=Noise)
    """Of the sensors."""
    rate: float = 10.0
    """[Hz] of the sensors."""
    known: np.ndarray | None = None
    """(n_p, n_p) [1 / unknowns^2] information of recordings that there are."""
    joints: tuple[float, ...] = ()
    """(n_j,) [rad or m] of the arm, which is held still; 0 where none is given."""

    def __post_init__(self) -> None:
        n_u = len(self.vehicle.actuators.names)
        if len(self.limits.thrust) != n_u:
            raise InvalidInput(f"thrust of {len(self.limits.thrust)} actuators given; allowed: {n_u}")
        if not (_SHORTEST <= self.duration <= _LONGEST and 0.0 < self.rate < np.inf):
            given = f"duration = {self.duration}, rate = {self.rate} given"
            raise InvalidInput(f"{given}; allowed: {_SHORTEST:g} to {_LONGEST:g} s, and a rate of more than 0")

    @property
    def unknowns(self) -> np.ndarray:
        """(n_p,) [as `Unknowns.start`]"""
        return np.concatenate([self.vehicle.shared.start, self.vehicle.own.start])

    @property
    def still(self) -> np.ndarray:
        """(3 n_j,) [as `Stage` has joints]"""
        n_j = self.vehicle.dynamics.model.nv - N_V
        return np.concatenate([self.joints or np.zeros(n_j), np.zeros(2 * n_j)])

    @property
    def chosen(self) -> list[int]:
        """Places of the m numbers that matter, as `numbers` has them. Raises NameNotFound for one that there is not."""
        return _chosen(slopes_of(self.vehicle, self.vehicle.shared.start)[0], self.matter)

    def aim(self) -> Aim:
        """Raises NameNotFound for a number that does not depend on the unknowns."""
        names, slopes = slopes_of(self.vehicle, self.vehicle.shared.start)
        chosen = slopes[_chosen(names, self.matter)]
        priors = np.concatenate([self.vehicle.shared.sigma, self.vehicle.own.sigma])
        known = np.zeros((len(priors),) * 2) if self.known is None else self.known
        return Aim(
            slopes=np.hstack([chosen, np.zeros((len(chosen), len(self.vehicle.own.start)))]),
            known=known + np.diag(1.0 / priors**2),
            noise=self.noise,
            rate=self.rate,
        )


def _chosen(names: Sequence[tuple[str, str]], matter: Sequence[str]) -> list[int]:
    """Places of numbers that are named, or whose quantity is; names: (quantity, number)."""
    for one in matter:
        if not any(one in pair for pair in names):
            raise NameNotFound("number", one, [number for _, number in names])
    return [k for k, pair in enumerate(names) if not matter or set(pair) & set(matter)]
