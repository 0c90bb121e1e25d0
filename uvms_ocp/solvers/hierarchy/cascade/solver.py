"""Strict hierarchy as a cascade of quadratic programs ([Kanoun2011], [Escande2014]) inside one CasADi Function."""

from __future__ import annotations

import contextlib
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial

import casadi as ca
import numpy as np

from uvms_ocp.arguments import checked, late
from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.solvers.hierarchy.cascade.qp_graph import (
    LevelStep,
    QpSettings,
    cascade,
    level_step,
    outcome,
    sanitised,
)
from uvms_ocp.solvers.hierarchy.cascade.qp_tick import QpFunctions, QpTick
from uvms_ocp.solvers.hierarchy.level import Level
from uvms_ocp.solvers.hierarchy.solution import Solution
from uvms_ocp.solvers.hierarchy.stacked import solved, tick_velocity
from uvms_ocp.solvers.hierarchy.tick import (
    Tick,
    check_levels_function,
    dense_inputs,
    dense_outputs,
)

_DEFAULTS: dict[str, dict[str, object]] = {
    "qpoases": {"printLevel": "none", "enableFlippingBounds": False},
    "qrqp": {"print_iter": False, "print_header": False, "print_info": False},
    "osqp": {"osqp": {"verbose": False}},
    "ipqp": {"print_iter": False, "print_header": False, "print_info": False},
    "highs": {"highs": {"output_flag": False}},
}


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LexicographicQp:
    """Each level minimises its own slack subject to the optimal slack of all levels above it.

    What a gate between 0 and 1 does is said in `uvms_ocp.solvers.hierarchy.gated_rows`.
    """

    plugin: str = "qpoases"
    """Any conic plugin of CasADi that solves quadratic programs."""
    options: Mapping[str, object] = field(default_factory=dict)
    """Options of the plugin, on top of our defaults."""
    proximal: float = 1e-10
    """[-] Weight of the distance to the velocity of the levels above, relative to the mean square of the rows: it makes each
    program strictly convex."""
    tolerance: float = 1e-9
    """[-] Largest accepted violation of a higher level, relative to its row."""
    attempts: int = 3
    """Programs per level at most; a further one starts where the last one ended."""
    certified: bool = True
    """Certify every result, which takes longer than the solution; else no result is called exact."""

    def __post_init__(self) -> None:
        """Raises `NameNotFound` for an unknown plugin, `InvalidInput` for a number out of range."""
        if not _exists(self.plugin):
            raise NameNotFound("conic plugin", self.plugin, conic_plugins())
        if not (0.0 < self.proximal < math.inf and 0.0 < self.tolerance < math.inf and self.attempts >= 1):
            given = f"proximal {self.proximal}, tolerance {self.tolerance}, attempts {self.attempts}"
            raise InvalidInput(f"{given}; give positive, finite numbers")

    @late
    def solve(self, levels: Sequence[Level]) -> Solution:
        """Raises `InvalidInput` where ``levels`` is empty or of mixed width."""
        return solved(levels, partial(tick_velocity, self.bind))

    def bind(self, levels_function: ca.Function, sizes: Sequence[int]) -> Tick:
        """One Function of ``levels_function`` and the cascade; outputs beyond the six of ``Level`` are extras."""
        check_levels_function(levels_function, sizes)
        inputs, names = dense_inputs(levels_function), levels_function.name_in()
        J, lower, upper, _, _, gate, *extras = dense_outputs(levels_function, inputs)
        # Some plugins print a banner through Python's stdout when they are created.
        with contextlib.redirect_stdout(io.StringIO()):
            steps = self._steps(J.shape[1], sizes)
        valid, J_safe, low, up = sanitised(J, lower, upper, gate)
        v, inexact = cascade(steps, J_safe, low, up)
        status, residual = outcome(valid, v, inexact, J, lower, upper, gate)
        outputs, raw = [v, status, residual, *extras], [J_safe, low, up, J, lower, upper, gate, *extras]
        tick = ca.Function("tick", inputs, outputs, names, [f"out_{i}" for i in range(len(outputs))])
        levels = ca.Function("levels", inputs, raw, names, [f"out_{i}" for i in range(len(raw))])
        return QpTick(QpFunctions(tick=tick, levels=levels, steps=steps, sizes=tuple(sizes), certified=self.certified))

    def _steps(self, n: int, sizes: Sequence[int]) -> list[LevelStep | None]:
        settings, above = self._settings(), np.cumsum([0, *sizes])
        return [level_step(settings, n, int(above[k]), size) if size else None for k, size in enumerate(sizes)]

    def _settings(self) -> QpSettings:
        options = {"error_on_fail": False, **_DEFAULTS.get(self.plugin, {}), **self.options}
        return QpSettings(
            plugin=self.plugin,
            options=options,
            proximal=self.proximal,
            tolerance=self.tolerance,
            attempts=self.attempts,
        )


def conic_plugins() -> tuple[str, ...]:
    """Names of the conic plugins of this CasADi that can be loaded."""
    entries = str(ca.CasadiMeta.plugins()).split(";")
    names = sorted(entry.removeprefix("Conic::") for entry in entries if entry.startswith("Conic::"))
    return tuple(name for name in names if _exists(name))


@cache
def _exists(plugin: str) -> bool:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return bool(ca.has_conic(plugin))
