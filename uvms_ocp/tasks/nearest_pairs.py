"""Distances of the pairs of shapes that come nearest, as parameters of a task.

They have no symbolic form, so they enter a tick as numbers: the task says how many pairs it needs,
and the control layer measures them (`uvms_ocp.control.velocity.distances`).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.shapes.collision_model import CollisionModel

FAR = 1e3
"""[m], [m/s] distance or speed that limits nothing."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PairSymbols:
    """Measured quantities of m pairs, as symbols."""

    smallest: ca.SX
    """() [m] smallest distance of all pairs now."""
    distance: ca.SX
    """(m,) [m] smallest distance of each pair on the way to rest."""
    closing: ca.SX
    """(m,) [m/s] speed of approach whose stop just leaves the threshold; `FAR` where the pair is
    nearest now.
    """
    jacobian: ca.SX
    """(m, n_v) [-, m] gradient of each distance at the place where it is smallest."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NearestPairs:
    """The pairs of shapes that come nearest on the way to rest. Raises `InvalidInput` for none.

    Their measured quantities are the last `n_parameters` parameters of the task: its rows read them
    by `symbols`, and its reference has `far_away` in their place.
    """

    task: str
    """Name of the task."""
    model: CollisionModel
    """Collision model with all pairs."""
    n: int
    """Largest number of pairs that are measured."""
    threshold: float
    """[m] least distance that the pairs are to keep."""

    def __post_init__(self) -> None:
        if self.n < 1:
            raise InvalidInput(f"{self.task}: n_nearest = {self.n}; give 1 or more")
        if self.model.n_pairs < 1:
            raise InvalidInput(
                f"{self.task}: a collision model without pairs; give obstacles or"
                " self_collision=True"
            )

    @property
    def n_rows(self) -> int:
        """Number m of pairs that are measured."""
        return min(self.n, self.model.n_pairs)

    @property
    def n_parameters(self) -> int:
        """Length of the vector that `parameters` returns."""
        return 1 + self.n_rows * (2 + self.model.n_v)

    def parameters(
        self, *, smallest: float, distance: np.ndarray, closing: np.ndarray, gradient: np.ndarray
    ) -> np.ndarray:
        """Return the measured quantities of `PairSymbols` as one vector (n_parameters,).

        smallest [m], distance (m,) [m], closing (m,) [m/s], gradient (m, n_v) [-, m].
        """
        return np.concatenate([[smallest], distance, closing, gradient.ravel(order="F")])

    def far_away(self) -> np.ndarray:
        """Return the parameters (n_parameters,) of pairs that are far away and do not move."""
        far = np.full(self.n_rows, FAR)
        return self.parameters(
            smallest=FAR,
            distance=far,
            closing=far,
            gradient=np.zeros((self.n_rows, self.model.n_v)),
        )

    def symbols(self, parameters: ca.SX) -> PairSymbols:
        """Return the measured quantities among the parameters of a task, the last of them."""
        n = self.n_rows
        measured = parameters[-self.n_parameters :]
        return PairSymbols(
            smallest=measured[0],
            distance=measured[1 : 1 + n],
            closing=measured[1 + n : 1 + 2 * n],
            jacobian=ca.reshape(measured[1 + 2 * n :], n, self.model.n_v),
        )
