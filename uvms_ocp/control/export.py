"""The tick of a scenario as C source that needs nothing but libm: levels, hierarchy solver, example, CMake file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.control.velocity.kinematic import HierarchySolver
from uvms_ocp.control.velocity.levels import LevelsProblem
from uvms_ocp.exceptions import InvalidInput, plain_line
from uvms_ocp.solvers.hierarchy.active_set.codes import STATUSES
from uvms_ocp.solvers.hierarchy.active_set.core_source import solver_declaration, solver_source
from uvms_ocp.solvers.hierarchy.active_set.patience import patience
from uvms_ocp.solvers.hierarchy.tick import Tick, TickResult, dense

TEMPLATES = ("tick.c", "example.c", "CMakeLists.txt")
_FINITE = 1e300  # stands in for a change without limit
FILES = ("levels.c", "active_set.c", "tick.h", "ticks.h", *TEMPLATES)  # that `write_tick` writes
_WINDOW = 25  # ticks recorded from the start and from every change of the gates


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RecordedTick:
    """One tick of a run."""

    inputs: tuple[np.ndarray, ...]
    """(n,) [each in its unit] of the levels function, in its order."""
    v: np.ndarray
    """(n_v,) [m/s, rad/s] that the solver found."""
    exact: bool
    """The solver vouches for v."""
    start: bool
    """The first of consecutive ticks."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RecordingSolver:
    """A solver that keeps the first ticks of every phase of a run."""

    solver: HierarchySolver
    """Which does the work."""
    ticks: list[RecordedTick] = field(default_factory=list)
    """Kept so far."""

    def bind(self, levels_function: ca.Function, sizes: tuple[int, ...]) -> Tick:
        return _RecordingTick(self.solver.bind(levels_function, sizes), self.ticks)


class _RecordingTick:
    __slots__ = ("_gates", "_left", "_tick", "_ticks")

    def __init__(self, tick: Tick, ticks: list[RecordedTick]) -> None:
        self._tick, self._ticks, self._left = tick, ticks, 0
        self._gates = np.zeros(0)

    def __call__(self, *inputs: ArrayLike) -> TickResult:
        result = self._tick(*inputs)
        gates = np.sign(inputs[-1])
        changed = not np.array_equal(gates, self._gates)
        self._gates, self._left = gates, _WINDOW if changed else self._left - 1
        if self._left > 0:
            kept = tuple(np.array(value, dtype=float) for value in inputs)
            self._ticks.append(RecordedTick(inputs=kept, v=result.v, exact=result.status.exact, start=changed))
        return result


def write_tick(problem: LevelsProblem, ticks: Sequence[RecordedTick], folder: Path) -> None:
    """Write levels.c, active_set.c, tick.h, ticks.h and the templates into `folder`, which exists.

    Raises `InvalidInput` for a run without a tick.
    """
    if not ticks:
        raise InvalidInput("no recorded tick to compare with; run the scenario for at least one tick")
    levels = dense(problem.function)
    for name, text in {
        "levels.c": _generated(levels),
        "active_set.c": solver_source(problem.function.size2_out(0), problem.sizes),
        "tick.h": _header(problem, levels),
        "ticks.h": _recorded(ticks),
        **{name: _template(name) for name in TEMPLATES},
    }.items():
        (folder / name).write_text(text, encoding="utf-8")


def _generated(levels: ca.Function) -> str:
    generator = ca.CodeGenerator("levels.c")
    generator.add(levels)
    return str(generator.dump())


def _template(name: str) -> str:
    return files("uvms_ocp.control").joinpath("export_templates", name).read_text(encoding="utf-8")


def _header(problem: LevelsProblem, levels: ca.Function) -> str:
    names, sizes = levels.name_in(), [levels.numel_in(i) for i in range(levels.n_in())]
    constants = {
        "N_IN": len(names),
        "N_V": problem.function.size2_out(0),
        "N_ROWS": sum(problem.sizes),
        "N_QUANTITIES": max(1, len(problem.quantity_names)),
        "SZ_ARG": levels.sz_arg(),
        "SZ_RES": levels.sz_res(),
        "SZ_IW": max(1, levels.sz_iw()),
        "SZ_W": max(1, levels.sz_w()),
        "PREVIOUS": names.index("previous"),
        "MOST_ITERATIONS": patience(sum(problem.sizes)).most_of_all,
    }
    step = np.minimum(problem.step, _FINITE)
    inputs = ", ".join(f"{name} ({size})" for name, size in zip(names, sizes, strict=True))
    return "\n".join(
        [
            "#ifndef TICK_H",
            "#define TICK_H",
            *(f"#define TICK_{name} {value}" for name, value in constants.items()),
            *_statuses(),
            f"static const int TICK_SIZE_IN[TICK_N_IN] = {{{', '.join(map(str, sizes))}}};",
            "/* Largest change of each velocity in one tick. */",
            f"static const double TICK_STEP[TICK_N_V] = {{{', '.join(f'{x:.17g}' for x in step)}}};",
            f"/* in: {inputs}.",
            f"   levels: {_comment(f'{n} ({m})' for n, m in zip(problem.names, problem.sizes, strict=True))}.",
            f"   quantities: {_comment(problem.quantity_names)}.",
            f"   Without an echo something finite stands in for altimeter_range, and unknown are: {_unknown(problem)}.",
            "   active_set: zeros before the first tick, then what the tick before left in it.",
            "   v: the velocity to command, whatever the status, which is returned. The viability rule and the mission are not",
            "   part of the tick. However many runs it takes, they have TICK_MOST_ITERATIONS iterations together. */",
            "int tick(const double *const in[TICK_N_IN], double active_set[TICK_N_ROWS], double v[TICK_N_V],",
            "         double quantities[TICK_N_QUANTITIES]);",
            solver_declaration(),
            "#endif",
            "",
        ]
    )


def _unknown(problem: LevelsProblem) -> str:
    names = zip(problem.quantity_names, problem.rests_on["altimeter_range"], strict=True)
    return _comment(name for name, ranged in names if ranged) or "none"


def _statuses() -> list[str]:
    """The codes, and a text for each."""
    return [
        "enum {",
        *(f"  TICK_{status.name} = {code}, /* {_comment([status.value])} */" for code, status in enumerate(STATUSES)),
        f"  TICK_N_STATUSES = {len(STATUSES)}",
        "};",
        "static const char *const TICK_MEANING[TICK_N_STATUSES] = {",
        *(f'  "{status.value}: {status.advice}",' for status in STATUSES),
        "};",
    ]


def _comment(names: Iterable[str]) -> str:
    """Names inside of a comment, which none of them ends."""
    return plain_line(", ".join(names)).replace("*/", "* /").replace("/*", "/ *").replace("\\", "/")


def _recorded(ticks: Sequence[RecordedTick]) -> str:
    inputs = [np.concatenate([value.ravel(order="F") for value in tick.inputs]) for tick in ticks]
    starts = ", ".join(str(int(tick.start)) for tick in ticks)
    exact = ", ".join(str(int(tick.exact)) for tick in ticks)
    return "\n".join(
        [
            f"#define TICKS {len(ticks)}",
            f"static const int TICK_STARTS[TICKS] = {{{starts}}};",
            f"static const int TICK_EXACT[TICKS] = {{{exact}}};",
            f"static const double TICK_INPUTS[TICKS][{len(inputs[0])}] = {_table(inputs)};",
            f"static const double TICK_VELOCITIES[TICKS][TICK_N_V] = {_table([tick.v for tick in ticks])};",
            "",
        ]
    )


def _table(rows: Sequence[np.ndarray]) -> str:
    return "{\n" + ",\n".join("{" + ", ".join(map(_literal, row)) + "}" for row in rows) + "}"


def _literal(x: float) -> str:
    """As C and its math.h spell it."""
    return f"{x:.17g}".replace("nan", "NAN").replace("inf", "INFINITY")
