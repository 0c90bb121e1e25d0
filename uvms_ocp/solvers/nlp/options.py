"""Options of solvers of lexicographic programs: tolerances, iterations, time limits, plugins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any

import casadi as ca

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput, NameNotFound, require_known
from uvms_ocp.types import DAY, AtLeastOne, Magnitude, Positive

AUTO = "auto"
IPOPT = "ipopt"
STAGEWISE = "stagewise"
PLUGINS = (AUTO, IPOPT, STAGEWISE)
QP_PLUGINS = ("hpipm", "proxqp", "piqp")
SPARSE_PLUGIN = QP_PLUGINS[0]
"""Default QP plugin of programs without stages."""
_WARM_START_PUSHES = [
    f"warm_start_{what}"
    for what in (
        "bound_push",
        "mult_bound_push",
        "slack_bound_push",
        "bound_frac",
        "slack_bound_frac",
    )
]
_WARM_START_OPTIONS: dict[str, Any] = {
    "warm_start_init_point": "yes",
    "mu_init": 1e-6,
    **dict.fromkeys(_WARM_START_PUSHES, 1e-9),
}


@checked_dataclass(eq=False)
class NlpOptions:
    """Options of the NLP solver. Raises `NameNotFound` for another plugin, `InvalidInput` for a
    number out of its range.
    """

    plugin: str = AUTO
    """``ipopt``, or ``stagewise`` for problems over a horizon. ``auto`` is ``stagewise`` where that
    takes a problem and there is a compiler, with ``ipopt`` where it does not come to an end; and
    ``ipopt`` for all other programs.
    """
    tolerance: Magnitude = 1e-6
    """Allowed rise of the residual of a solved level, as a norm. With 0 rows of equalities are
    frozen as equality constraints: not for levels whose rows contradict each other, where no
    constraint qualification holds.
    """
    convergence: Positive = 1e-8
    """Largest error of the optimality conditions at the point itself, without any damping; where
    the gradient of the cost is above 100 there, in units of a hundredth of it.
    """
    max_iterations: AtLeastOne = 150
    """Largest number of iterations of every NLP."""
    time_limit: Positive = DAY
    """[s] for all NLPs together; by default iterations end them, however busy the machine is.
    Iterations are not cut short.
    """
    anticipate: bool = True
    """Try the lowest level first, with all levels above met in full."""
    barrier: Positive = 1e-2
    """Barrier parameter at a cold start."""
    plugin_options: Mapping[str, Any] = field(default_factory=dict)
    """Options of the plugin itself, on top of ours."""

    @property
    def feasibility(self) -> float:
        """Largest violation of scaled rows with which a point counts as usable."""
        return max(1e-5, self.convergence)

    def __post_init__(self) -> None:
        require_known("NLP solver", self.plugin, PLUGINS)
        if self.time_limit > DAY:
            raise InvalidInput(f"time_limit = {self.time_limit:g} s; give at most {DAY:g} s, a day")


@checked_dataclass(eq=False)
class SqpOptions:
    """Options of a step, and of the decision for another one.

    Raises `NameNotFound` for another plugin, `InvalidInput` for one that this CasADi lacks, or a
    number that is not positive.
    """

    plugin: str | None = None
    """``stagewise``, the fastest, and ``hpipm`` know horizons only; ``proxqp`` and ``piqp`` take
    any program. None: for `Nmpc` ``stagewise`` where there is a C compiler and no level above the
    last has ``relax``; else ``hpipm``.
    """
    max_steps: AtLeastOne = 3
    """Largest number of steps of every solve."""
    accuracy: Positive = 1e-2
    """Largest violation of scaled rows with which a point counts as usable, and no further step is
    made.
    """
    tolerance: Positive = 1e-3
    """Allowed rise of the norm of a level's residual for the sake of all levels below."""
    damping: Positive = 1e-6
    """[1/unit of x^2] Added to the diagonal of the Hessian, so that what no term determines does
    not move.
    """
    proximal: Positive = 1e-4
    """[1/unit of x^2] Least weight of the distance from where the levels above left the point; see
    `ProximalWeights`.
    """

    def __post_init__(self) -> None:
        if self.plugin not in (None, *QP_PLUGINS, STAGEWISE):
            raise NameNotFound("QP solver", str(self.plugin), (*QP_PLUGINS, STAGEWISE))
        if self.plugin in QP_PLUGINS and not ca.has_conic(self.plugin):
            raise InvalidInput(
                f"this CasADi has no QP solver {self.plugin!r}; give another of"
                f" {', '.join(QP_PLUGINS)}"
            )


def solver_options(options: NlpOptions, *, warm: bool) -> dict[str, Any]:
    """Return options of IPOPT itself, for a start with or without multipliers."""
    ipopt_options: dict[str, Any] = {
        "print_level": 0,
        "sb": "yes",
        "tol": options.convergence,
        "max_iter": options.max_iterations,
        "max_wall_time": options.time_limit,
        "mu_init": options.barrier,
        # Bounds give way by this much: rows that are frozen must not.
        "bound_relax_factor": min(1e-8, 0.01 * (options.tolerance or 1e-6)),
    }
    if warm:
        ipopt_options |= _WARM_START_OPTIONS
    return ipopt_options | dict(options.plugin_options)
