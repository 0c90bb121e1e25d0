"""What a robot's file may say of what was learnt: what stays open is as it was declared, and all else is fitted anew about it.

An unknown that recordings do not determine ends anywhere, often at next to nothing, and a vehicle would fly with it. The others
have taken its part where they were fitted with it: they are not kept as they were either. What is next to nothing because the
recordings say so, as drag that another one takes the place of, stays so: as it was before it would contradict them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.identification.answers.certainty import DETERMINED, certainties
from uvms_ocp.identification.answers.fitted import Fitted
from uvms_ocp.identification.answers.numbers import INTERVAL
from uvms_ocp.identification.methods.output_error import Estimate, FitStatus
from uvms_ocp.identification.parameters.unknowns import Unknowns


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Flown:
    """Of an estimate."""

    estimate: Estimate
    kept: tuple[str, ...] = ()
    """Unknowns that are as they were declared, as ``added_mass surge``."""

    @property
    def usable(self) -> bool:
        """Whether a file may be made of it: the search has converged."""
        return self.estimate.status is FitStatus.CONVERGED


def flown(fitted: Fitted, together: float) -> Flown:
    """All that is open is held where the recordings allow it, or else of one quantity after the other.

    together: [-] samples that miss alike, as `correlated` finds.
    """
    shared, estimate = fitted.vehicle.shared, fitted.estimate
    is_open = np.array([one.sigma > DETERMINED for one in certainties(fitted.vehicle, estimate, together)], dtype=bool)
    kept, best = np.zeros(len(is_open), dtype=bool), estimate
    if estimate.status is FitStatus.CONVERGED:
        for chosen in _chosen(shared, is_open):
            found = None if (chosen <= kept).all() else _held(fitted, kept | chosen)
            allowed = INTERVAL**2 * together * int((kept | chosen).sum())
            if found is not None and 2.0 * (found.cost - estimate.cost) < allowed:
                kept, best = kept | chosen, found
    return Flown(estimate=best, kept=tuple(np.array(shared.names)[kept].tolist()))


def _chosen(shared: Unknowns, is_open: np.ndarray) -> Iterator[np.ndarray]:
    """(n,) bool: all, then quantity by quantity."""
    yield is_open
    quantities = np.array([name.partition(" ")[0] for name in shared.names])
    for name in dict.fromkeys(quantities.tolist()):
        yield is_open & (quantities == name)


def _held(fitted: Fitted, which: np.ndarray) -> Estimate | None:
    """With those of which (n,) bool where they were declared, and all others fitted anew; none where that does not converge."""
    shared = fitted.vehicle.shared
    problem = replace(fitted, vehicle=replace(fitted.vehicle, shared=shared.held(which))).problem()
    near = problem.start(np.where(which, shared.start, fitted.estimate.shared))
    found = problem.solve(near, iterations=fitted.search.iterations)
    exact = replace(found, shared=np.where(which, shared.start, found.shared))
    return exact if found.status is FitStatus.CONVERGED else None
