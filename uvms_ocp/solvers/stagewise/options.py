"""How exactly a QP of stages is solved, and what may do it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class StageQpOptions:
    """Raises `InvalidInput` for numbers that are not positive and finite."""

    tolerance: float = 1e-9
    """[-] of the KKT conditions, relative to the largest term in them."""
    max_iterations: int = 60
    """[-] factorisations; as many again for a QP that may be infeasible."""
    warm_mu: float = 1e-4
    """[-] of a warm start: complementarity relative to that of a cold one."""
    compiled: bool = True
    """False keeps to NumPy."""

    def __post_init__(self) -> None:
        for name in ("tolerance", "max_iterations", "warm_mu"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InvalidInput(f"{name} = {getattr(self, name)}; give a finite value > 0")
