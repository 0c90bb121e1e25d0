"""How real-time SQP makes a step."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.solvers.nlp.nlp_options import STAGEWISE

QP_PLUGINS = ("hpipm", "proxqp", "piqp")
OF_MATRICES = QP_PLUGINS[0]
"""By default, of programs without stages."""


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SqpOptions:
    """How a step is made, and when another one is.

    Raises `NameNotFound` for another plugin, `InvalidInput` for one that this CasADi lacks, or a number that is not positive.
    """

    plugin: str | None = None
    """``stagewise``, the fastest, and ``hpipm`` know horizons only; ``proxqp`` and ``piqp`` take any program. None: for `Nmpc`
    ``stagewise`` where there is a C compiler and no level above the last has `relax`; else ``hpipm``."""
    max_steps: int = 3
    """For every solve."""
    accuracy: float = 1e-2
    """[-] Largest violation of scaled rows with which a point counts as usable, and no further step is made."""
    tolerance: float = 1e-3
    """[-] By which the norm of a level's residual may rise for the sake of all levels below."""
    damping: float = 1e-6
    """[1/unit of x^2] Added to the diagonal of the Hessian, so that what no term determines does not move."""
    proximal: float = 1e-4
    """[1/unit of x^2] Least weight of the distance from where the levels above left the point; see `proximal.py`."""

    def __post_init__(self) -> None:
        if self.plugin not in (None, *QP_PLUGINS, STAGEWISE):
            raise NameNotFound("QP solver", str(self.plugin), (*QP_PLUGINS, STAGEWISE))
        if self.plugin in QP_PLUGINS and not ca.has_conic(self.plugin):
            raise InvalidInput(f"this CasADi has no QP solver {self.plugin!r}; give another of {', '.join(QP_PLUGINS)}")
        for name in self.__dataclass_fields__:
            if name != "plugin" and not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InvalidInput(f"{name} = {getattr(self, name)}; give a finite value > 0")
