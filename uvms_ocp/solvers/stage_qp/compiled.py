"""Run the interior-point method in C on memory made once for a shape."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from functools import lru_cache, partial
from importlib.resources import files
from typing import Any

import numpy as np

from uvms_ocp.codegen.c_text import WIDE_MACROS, c_macros, constants_of
from uvms_ocp.codegen.libraries import compile_library
from uvms_ocp.codegen.loading import loaded_library
from uvms_ocp.solvers.stage_qp import problem, tolerances
from uvms_ocp.solvers.stage_qp.options import StageQpOptions
from uvms_ocp.types import Array

_HEAD = "#include <math.h>\n#include <stddef.h>\n#include <string.h>\n" + WIDE_MACROS
_SOURCES = ("blocks.c", "riccati.c", "interior_point.c", "iteration.c")
# At -O3 the blocks leave the registers again.
_FLAGS = ("-O2", "-ftree-vectorize", "-std=c99")
_STATUSES = tuple(problem.StageQpStatus)
_SIZES = ("n_x", "n_u", "n_r", "n_c")
_PLACES = ("x", "z", "r", "c", "F", "J", "H", "C", "T")
_DATA = {
    "dynamics": "dynamics",
    "offset": "b",
    "rows": "J",
    "residual": "r",
    "hessian": "H",
    "gradient": "g",
    "damping": "damping",
    "constraints": "C",
}
"""Data of a QP: names in C, and in `StageQp.flat`."""
_STAGE_WORK = (
    "fixed",
    "Q",
    "q",
    "L",
    "inverse",
    "first",
    "column",
    "entry",
    "W",
    "two",
    "v",
    "list",
)
_TABLE = ("bound", "side", "elastic", "equal", "target", "l1", "l2", "compliance", "norm")
_BOUNDS = {
    name: name.removeprefix("c_")
    for name in ("lower", "upper", "c_l1", "c_l2", "z_lower", "z_upper", "z_l1", "z_l2")
}
_HELD = ("loose", "active", "no_side", "held_equal", "held_target")
_WORK = ("elasticity", "point", "best", "step", "affine", "trial")
_DIRECTION = ("weight", "soft", "left", "gap", "pull", "rhs", "t_side", "t_elastic")
_RESIDUALS = ("grad", "held", "defect", "value", "row", "equal", "dual")


def _fields(kind: type[Any], *names: str) -> tuple[tuple[str, Any], ...]:
    return tuple((name, kind) for name in names)


_pointers, _numbers, _integers = (
    partial(_fields, kind) for kind in (ctypes.c_void_p, ctypes.c_double, ctypes.c_int)
)


class _Stages(ctypes.Structure):
    """Mirror of `Stages` in riccati.c."""

    _fields_ = (
        *_integers("N", "squares"),
        *_pointers(*_SIZES, *_PLACES, *_DATA, *_STAGE_WORK),
        *_numbers("most", "least"),
    )


class _Residuals(ctypes.Structure):
    """Mirror of `Residuals` in interior_point.c."""

    _fields_ = (
        *_pointers(*_RESIDUALS),
        *_numbers(
            "stationarity",
            "primal",
            "complementarity",
            "steepest",
            "gradient",
            "variable",
            "linear",
            "worst",
        ),
        ("along", ctypes.c_double * 3),
    )


class _Problem(ctypes.Structure):
    """Mirror of `Problem` in interior_point.c."""

    _fields_ = (
        ("stages", _Stages),
        *_integers("M", "m", "n", "n_x"),
        *_pointers(*_TABLE, *_BOUNDS, *_HELD, *_WORK, *_DIRECTION, "bounded"),
        ("now", _Residuals),
        ("other", _Residuals),
        *_numbers("curvature", "tolerance", "warm_mu", "cold_mu", "slow", "share"),
        *_integers(
            "n_bounded",
            "max_iterations",
            "iterations",
            "corrections",
            "status",
            "start",
            "is_elastic",
        ),
    )


class CompiledCore:
    """Solver of QPs of one shape."""

    def __init__(self, library: ctypes.CDLL, shape: problem.StageShape) -> None:
        n = sum(shape.n_z)
        m = sum(shape.n_c)
        n_x = sum(shape.n_x)
        M = m + n
        self._library = library
        self._shape = shape
        self._problem = _Problem(M=M, m=m, n=n, n_x=n_x)
        self._problem.stages.N = shape.N
        # What ctypes only knows the address of.
        self._indices = _indices(shape)
        self._stage_work = _stage_work(shape)
        self._work = _work(n, m, n_x)
        self._table = _table(n, m)
        # Variables, costates, multipliers of equalities, then slacks and multipliers of both sides
        # of each row.
        self._parts = problem.parts(self._work["point"], (n, n_x, M, 2 * M, 2 * M))
        self._warm_start = self._work["point"][: n + n_x + M]
        self._work["loose"][:] = problem.undetermined_variables(shape)
        self._loaded: problem.StageQp | None = None
        self._products = (ctypes.c_double * 3)()
        self._residuals = _residuals(n, m, n_x)
        self._trial_residuals = _residuals(n, m, n_x)
        _point(self._problem.stages, {**self._indices, **self._stage_work})
        _point(self._problem, self._work | self._table)
        _point(self._problem.now, self._residuals)
        _point(self._problem.other, self._trial_residuals)

    def run(
        self,
        qp: problem.StageQp,
        table: problem.RowTable,
        z: Array,
        options: StageQpOptions,
        *,
        phase_one: bool,
    ) -> problem.FlatSolution:
        """Run from z (n,) [unit of z] with the rows of a table: without the cost in phase one, else
        with steps that are damped in directions without curvature.
        """
        self._load(qp, options)
        for name, array in self._table.items():
            array[:] = np.ravel(getattr(table, name).T)
        self._stage_work["fixed"][:] = table.fixed
        self._work["point"][:] = 0.0
        self._parts[0][:] = z
        start = problem.StartMode.EQUALITIES if phase_one else problem.StartMode.COLD
        self._problem.start = int(start)
        self._library.solve_qp(ctypes.byref(self._problem), int(phase_one), int(not phase_one))
        return self._end(qp)

    def solve(
        self,
        qp: problem.StageQp,
        options: StageQpOptions,
        warm_start: problem.WarmStart | None,
    ) -> problem.FlatSolution:
        """Solve from nothing but the QP, or from a QP nearby; NOT_A_NUMBER where entries are
        none.
        """
        self._load(qp, options)
        if warm_start is not None:
            point = [warm_start.z, warm_start.costate, warm_start.y]
            np.concatenate(point, out=self._warm_start)
        self._library.solve_whole(ctypes.byref(self._problem), int(warm_start is not None))
        return self._end(qp)

    def products(self, qp: problem.StageQp, z: Array) -> problem.ResidualProducts:
        """Return the products of the residuals' rows along z (n,) [unit of z]."""
        self._load(qp, None)
        self._library.products(ctypes.byref(self._problem.stages), _address(z), self._products)
        return problem.ResidualProducts(*self._products)

    def steepest(self, qp: problem.StageQp) -> float:
        """Return the largest entry [1/unit of z] of the gradient of the residuals' half square, at
        0.
        """
        self._load(qp, None)
        return float(self._library.steepest(ctypes.byref(self._problem.stages)))

    def stationarity(self, qp: problem.StageQp, warm_start: problem.WarmStart) -> float:
        """Return the largest entry [1/unit of z] of the gradient of a QP's Lagrangian at 0 with the
        multipliers of another, but for what is fixed.
        """
        self._load(qp, None)
        stages = ctypes.byref(self._problem.stages)
        costate = _address(warm_start.costate)
        y = _address(warm_start.y)
        return float(self._library.stationarity(stages, costate, y, ctypes.c_int(self._problem.m)))

    def _load(self, qp: problem.StageQp, options: StageQpOptions | None) -> None:
        """Point the memory at the data of a QP, and set the options."""
        memory = self._problem
        if qp is not self._loaded:
            _point(memory.stages, {name: qp.flat[flat_name] for name, flat_name in _DATA.items()})
            _point(memory, {name: qp.flat[flat_name] for name, flat_name in _BOUNDS.items()})
            self._loaded = qp
        if options is not None:
            memory.tolerance = options.tolerance
            memory.max_iterations = options.max_iterations
            memory.warm_mu = options.warm_mu
            memory.cold_mu = options.cold_mu

    def _end(self, qp: problem.StageQp) -> problem.FlatSolution:
        """Return the solution that a run has left in memory."""
        memory = self._problem
        iterate = self._problem.now
        z, costate, y_equal, _, y_sides = self._parts
        y = y_equal + y_sides[1::2]
        y -= y_sides[::2]
        y[memory.m :] -= self._residuals["held"]
        if memory.stages.squares:
            products = problem.ResidualProducts(*iterate.along)
        else:
            products = self.products(qp, z)
        return problem.FlatSolution(
            status=_STATUSES[memory.status],
            z=z.copy(),
            costate=costate.copy(),
            y=y,
            value=self._residuals["value"].copy(),
            kkt=problem.kkt_residual(
                stationarity=iterate.stationarity,
                primal=iterate.primal,
                complementarity=iterate.complementarity,
            ),
            worst=iterate.worst,
            iterations=memory.iterations,
            shape=self._shape,
            products=products,
        )


def _point(structure: ctypes.Structure, arrays: Mapping[str, Any]) -> None:
    for name, array in arrays.items():
        setattr(structure, name, array.ctypes.data)


def _address(array: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


@lru_cache(maxsize=1)
def qp_library() -> ctypes.CDLL | None:
    """Return the code of `core_source`, compiled at the first call; None without a compiler."""
    path = compile_library(core_source(), _FLAGS, "QPs of stages")
    if path is None:
        return None
    library = loaded_library(path)
    library.stationarity.restype = ctypes.c_double
    library.steepest.restype = ctypes.c_double
    return library


def core_source() -> str:
    """Return the C99 source of the solver, for all shapes: `solve_qp` of iteration.c; needs libm
    only and allocates nothing.
    """
    folder = files("uvms_ocp.solvers.stage_qp")
    texts = [folder.joinpath(name).read_text(encoding="utf-8") for name in _SOURCES]
    codes = ", ".join(f"{status.name} = {code}" for code, status in enumerate(_STATUSES))
    starts = ", ".join(f"START_{start.name} = {start.value}" for start in problem.StartMode)
    enumerations = f"enum {{ {codes} }};\nenum {{ {starts} }};"
    return "\n".join([_HEAD, c_macros(constants_of(tolerances)), enumerations, *texts])


def _indices(shape: problem.StageShape) -> dict[str, Any]:
    """Make the sizes of each stage, and where each part of a stage begins in its array."""
    n_z = shape.n_z
    sizes: dict[str, Sequence[int]] = {
        "x": shape.n_x,
        "z": n_z,
        "r": shape.n_r,
        "c": shape.n_c,
        "T": [_triangle(n) for n in n_z],
        "F": _entries(shape.n_x[1:], n_z),
        "J": _entries(shape.n_r, n_z),
        "H": _entries(n_z, n_z),
        "C": _entries(shape.n_c, n_z),
    }
    indices = dict[str, Any]()
    for name in _SIZES:
        indices[name] = np.array((*getattr(shape, name), 0), dtype=np.int32)
    for name, size in sizes.items():
        indices[name] = np.array(problem.offsets(size), dtype=np.int32)
    return indices


def _entries(rows: Sequence[int], columns: Sequence[int]) -> list[int]:
    """Count the entries of matrices (m, n), as many as there are m."""
    return [m * n for m, n in zip(rows, columns, strict=False)]


def _triangle(n: int) -> int:
    return n * (n + 1) // 2


def padded(n: int) -> int:
    """Return the number of columns that C gives a matrix of n."""
    return (n + 3) // 4 * 4


def _stage_work(shape: problem.StageShape) -> dict[str, Any]:
    n = sum(shape.n_z)
    widest = padded(max(shape.n_z))
    triangles = sum(_triangle(n_z) for n_z in shape.n_z)
    entries = sum(_entries(shape.n_x[1:], shape.n_z))
    sizes = {
        "fixed": n,
        "Q": triangles,
        "q": n,
        "L": triangles,
        "inverse": n,
        "entry": entries,
        "two": 2 * widest**2,
        "W": 2 * padded(max(shape.n_x)) * widest,
        "v": widest,
        "list": 14 * max(*shape.n_r, *shape.n_c),
    }
    memory: dict[str, Any] = {name: np.zeros(size + 4) for name, size in sizes.items()}
    memory["fixed"] = np.zeros(n)
    memory["first"] = np.zeros(sum(shape.n_x) + 1, dtype=np.int32)
    memory["column"] = np.zeros(entries, dtype=np.int32)
    return memory


def _work(n: int, m: int, n_x: int) -> dict[str, Any]:
    M = m + n
    sizes = dict.fromkeys((*_WORK, *_DIRECTION), n + n_x + 9 * M)
    sizes |= dict.fromkeys(("weight", "soft", "left", "gap", "t_side", "t_elastic"), 2 * M)
    sizes |= dict.fromkeys(_HELD, 2 * M)
    sizes |= {"elasticity": M, "pull": M, "rhs": n, "loose": n}
    memory: dict[str, Any] = {name: np.zeros(size) for name, size in sizes.items()}
    memory["bounded"] = np.zeros(M, dtype=np.int32)
    return memory


def _table(n: int, m: int) -> dict[str, Array]:
    M = m + n
    sizes = dict.fromkeys(_TABLE, M)
    sizes |= dict.fromkeys(("bound", "side", "elastic"), 2 * M)
    return {name: np.zeros(size) for name, size in sizes.items()}


def _residuals(n: int, m: int, n_x: int) -> dict[str, Array]:
    M = m + n
    sizes = {
        "grad": n,
        "held": n,
        "defect": n_x,
        "value": M,
        "row": 2 * M,
        "equal": M,
        "dual": 2 * M,
    }
    return {name: np.zeros(size) for name, size in sizes.items()}
