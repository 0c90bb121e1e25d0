"""Options of the NLP solvers and of real-time SQP."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.types import DAY

# How the NLPs of a lexicographic program are solved.

STAGEWISE = "stagewise"
PLUGINS = ("ipopt", "fatrop", STAGEWISE)


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NlpOptions:
    """Options of the NLP solver. Raises `NameNotFound` for another plugin, `InvalidInput` for a number out of its range."""

    plugin: str = "ipopt"
    """``ipopt``, ``fatrop``, or ``stagewise`` for problems over a horizon."""
    tolerance: float = 1e-6
    """Allowed rise of the residual of a solved level, as a norm. With 0, and always with fatrop, rows of equalities are frozen
    as equality constraints: not for levels whose rows contradict each other, where no constraint qualification holds."""
    convergence: float = 1e-8
    """Largest error of the optimality conditions, as the plugin scales them."""
    max_iterations: int = 150
    """For every NLP."""
    time_limit: float = 20.0
    """[s] for all NLPs together. Iterations are not cut short; fatrop looks at it between NLPs only."""
    anticipate: bool = True
    """Try the lowest level first, with all levels above met in full."""
    barrier: float = 1e-2
    """Barrier parameter at a cold start."""
    plugin_options: Mapping[str, Any] = field(default_factory=dict)
    """Options of the plugin itself, on top of ours."""

    @property
    def feasibility(self) -> float:
        """Largest violation of scaled rows with which a point counts as usable."""
        return max(1e-5, self.convergence)

    @property
    def freezing(self) -> float:
        """`tolerance`, 0 where rows are frozen as equalities."""
        return 0.0 if self.plugin == "fatrop" else self.tolerance

    def __post_init__(self) -> None:
        if self.plugin not in PLUGINS:
            raise NameNotFound("NLP solver", self.plugin, PLUGINS)
        for name in ("convergence", "max_iterations", "time_limit", "barrier"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise InvalidInput(f"{name} = {value}; give a finite value > 0")
        if self.time_limit > DAY:
            raise InvalidInput(f"time_limit = {self.time_limit:g} s; give at most {DAY:g} s, a day")
        if not (np.isfinite(self.tolerance) and self.tolerance >= 0):
            raise InvalidInput(f"tolerance = {self.tolerance}; give a finite value >= 0")


def solver_options(options: NlpOptions, *, warm: bool) -> dict[str, Any]:
    """Options of the plugin itself, for a start with or without multipliers."""
    chosen: dict[str, Any] = {
        "print_level": 0,
        "tol": options.convergence,
        "max_iter": options.max_iterations,
        "mu_init": options.barrier,
    }
    if options.plugin == "ipopt":
        chosen |= {
            "sb": "yes",
            "max_wall_time": options.time_limit,
            # Bounds give way by this much: rows that are frozen must not.
            "bound_relax_factor": min(1e-8, 0.01 * (options.tolerance or 1e-6)),
        }
    if warm:
        chosen |= _WARM[options.plugin]
    return chosen | dict(options.plugin_options)


_WARM: dict[str, dict[str, Any]] = {
    "ipopt": {
        "warm_start_init_point": "yes",
        "mu_init": 1e-6,
        "warm_start_bound_push": 1e-9,
        "warm_start_mult_bound_push": 1e-9,
        "warm_start_slack_bound_push": 1e-9,
        "warm_start_bound_frac": 1e-9,
        "warm_start_slack_bound_frac": 1e-9,
    },
    "fatrop": {"mu_init": 1e-6},
}


# How real-time SQP makes a step.

QP_PLUGINS = ("hpipm", "proxqp", "piqp")
SPARSE_PLUGIN = QP_PLUGINS[0]
"""Default QP plugin of programs without stages."""


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SqpOptions:
    """Options of a step, and of the decision for another one.

    Raises `NameNotFound` for another plugin, `InvalidInput` for one that this CasADi lacks, or a number that is not positive.
    """

    plugin: str | None = None
    """``stagewise``, the fastest, and ``hpipm`` know horizons only; ``proxqp`` and ``piqp`` take any program. None: for `Nmpc`
    ``stagewise`` where there is a C compiler and no level above the last has `relax`; else ``hpipm``."""
    max_steps: int = 3
    """For every solve."""
    accuracy: float = 1e-2
    """Largest violation of scaled rows with which a point counts as usable, and no further step is made."""
    tolerance: float = 1e-3
    """Allowed rise of the norm of a level's residual for the sake of all levels below."""
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
