"""Run the interior-point method in C on memory made once for a shape."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from functools import lru_cache, partial
from importlib.resources import files
from typing import Any

import numpy as np

from uvms_ocp.codegen.compile import (
    WIDE_MACROS,
    c_macros,
    compile_library,
    constants_of,
    loaded_library,
)
from uvms_ocp.solvers.stage_qp import problem, tolerances
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
}
_DATA |= {"damping": "damping", "constraints": "C"}
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
    """The solver of one shape."""

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
        self._near = self._work["point"][: n + n_x + M]
        self._work["loose"][:] = problem.undetermined_variables(shape)
        self._loaded: problem.StageQp | None = None
        self._found = (ctypes.c_double * 3)()
        self._now, self._other = (_residuals(n, m, n_x) for _ in range(2))
        _point(self._problem.stages, {**self._indices, **self._stage_work})
        _point(self._problem, self._work | self._table)
        _point(self._problem.now, self._now)
        _point(self._problem.other, self._other)

    def run(
        self,
        qp: problem.StageQp,
        table: problem.RowTable,
        z: Array,
        options: problem.StageQpOptions,
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
        self._problem.start = int(
            problem.StartMode.EQUALITIES if phase_one else problem.StartMode.COLD
        )
        self._library.solve_qp(ctypes.byref(self._problem), int(phase_one), int(not phase_one))
        return self._end(qp)

    def solve(
        self, qp: problem.StageQp, options: problem.StageQpOptions, near: problem.WarmStart | None
    ) -> problem.FlatSolution:
        """Solve as `SparseCore.solve`."""
        self._load(qp, options)
        if near is not None:
            np.concatenate([near.z, near.costate, near.y], out=self._near)
        self._library.solve_whole(ctypes.byref(self._problem), int(near is not None))
        return self._end(qp)

    def products(self, qp: problem.StageQp, z: Array) -> problem.ResidualProducts:
        """Compute products as `SparseCore.products`; z (n,) [unit of z]."""
        self._load(qp, None)
        self._library.products(ctypes.byref(self._problem.stages), _address(z), self._found)
        return problem.ResidualProducts(*self._found)

    def steepest(self, qp: problem.StageQp) -> float:
        """Return the steepest slope as `SparseCore.steepest`."""
        self._load(qp, None)
        return float(self._library.steepest(ctypes.byref(self._problem.stages)))

    def stationarity(self, qp: problem.StageQp, near: problem.WarmStart) -> float:
        """Return the stationarity error as `SparseCore.stationarity`."""
        self._load(qp, None)
        stages = ctypes.byref(self._problem.stages)
        m = ctypes.c_int(self._problem.m)
        return float(
            self._library.stationarity(stages, _address(near.costate), _address(near.y), m)
        )

    def _load(self, qp: problem.StageQp, options: problem.StageQpOptions | None) -> None:
        memory = self._problem
        if qp is not self._loaded:
            _point(
                memory.stages, {name: qp.flat[memory_slice] for name, memory_slice in _DATA.items()}
            )
            _point(memory, {name: qp.flat[memory_slice] for name, memory_slice in _BOUNDS.items()})
            self._loaded = qp
        if options is not None:
            memory.tolerance = options.tolerance
            memory.max_iterations = options.max_iterations
            memory.warm_mu = options.warm_mu
            memory.cold_mu = options.cold_mu

    def _end(self, qp: problem.StageQp) -> problem.FlatSolution:
        memory = self._problem
        iterate = self._problem.now
        (z, costate, equal, _, sides) = self._parts
        y = equal + sides[1::2]
        y -= sides[::2]
        y[memory.m :] -= self._now["held"]
        return problem.FlatSolution(
            status=_STATUSES[memory.status],
            z=z.copy(),
            costate=costate.copy(),
            y=y,
            value=self._now["value"].copy(),
            kkt=problem.kkt_residual(
                stationarity=iterate.stationarity,
                primal=iterate.primal,
                complementarity=iterate.complementarity,
            ),
            worst=iterate.worst,
            iterations=memory.iterations,
            shape=self._shape,
            products=problem.ResidualProducts(*iterate.along)
            if memory.stages.squares
            else self.products(qp, z),
        )


def _point(structure: ctypes.Structure, arrays: Mapping[str, Any]) -> None:
    for name, array in arrays.items():
        setattr(structure, name, array.ctypes.data)


def _address(array: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


@lru_cache(maxsize=1)
def qp_library() -> ctypes.CDLL | None:
    """The code of `core_source`, compiled at the first call; None without a compiler."""
    path = compile_library(core_source(), _FLAGS, "QPs of stages")
    if path is None:
        return None
    library = loaded_library(path)
    library.stationarity.restype = library.steepest.restype = ctypes.c_double
    return library


def core_source() -> str:
    """C99 source of the solver, for all shapes: `solve_qp` of iteration.c; needs libm only and
    allocates nothing.
    """
    folder = files("uvms_ocp.solvers.stage_qp")
    texts = (folder.joinpath(name).read_text(encoding="utf-8") for name in _SOURCES)
    codes = ", ".join(f"{status.name} = {code}" for code, status in enumerate(_STATUSES))
    starts = ", ".join(f"START_{start.name} = {start.value}" for start in problem.StartMode)
    return "\n".join(
        [
            _HEAD,
            c_macros(constants_of(tolerances)),
            f"enum {{ {codes} }};\nenum {{ {starts} }};",
            *texts,
        ]
    )


def _indices(shape: problem.StageShape) -> dict[str, Any]:
    n_x = shape.n_x
    n_z = shape.n_z
    n_r = shape.n_r
    n_c = shape.n_c
    products = {"F": (n_x[1:], n_z), "J": (n_r, n_z), "H": (n_z, n_z), "C": (n_c, n_z)}
    sizes = {"x": n_x, "z": n_z, "r": n_r, "c": n_c, "T": [n * (n + 1) // 2 for n in n_z]}
    sizes |= {name: [m * n for m, n in zip(*pair, strict=False)] for name, pair in products.items()}
    stage_sizes = {name: np.array((*getattr(shape, name), 0), dtype=np.int32) for name in _SIZES}
    return {
        **stage_sizes,
        **{name: np.array(problem.offsets(size), dtype=np.int32) for name, size in sizes.items()},
    }


def padded(n: int) -> int:
    """Columns that C gives a matrix of n."""
    return (n + 3) // 4 * 4


def _stage_work(shape: problem.StageShape) -> dict[str, Any]:
    n, widest, triangles = (
        sum(shape.n_z),
        padded(max(shape.n_z)),
        sum(n * (n + 1) // 2 for n in shape.n_z),
    )
    entries = sum(m * n for m, n in zip(shape.n_x[1:], shape.n_z, strict=False))
    sizes = {
        "fixed": n,
        "Q": triangles,
        "q": n,
        "L": triangles,
        "inverse": n,
        "entry": entries,
        "two": 2 * widest**2,
    }
    sizes |= {
        "W": 2 * padded(max(shape.n_x)) * widest,
        "v": widest,
        "list": 14 * max(*shape.n_r, *shape.n_c),
    }
    numbers = {name: np.zeros(size + 4) for name, size in sizes.items()} | {"fixed": np.zeros(n)}
    return numbers | {
        "first": np.zeros(sum(shape.n_x) + 1, dtype=np.int32),
        "column": np.zeros(entries, dtype=np.int32),
    }


def _work(n: int, m: int, n_x: int) -> dict[str, Any]:
    M = m + n
    sizes = {"elasticity": M, "pull": M, "rhs": n}
    sizes |= dict.fromkeys(("weight", "soft", "left", "gap", "t_side", "t_elastic"), 2 * M)
    numbers = {name: np.zeros(sizes.get(name, n + n_x + 9 * M)) for name in (*_WORK, *_DIRECTION)}
    held = {name: np.zeros(2 * M) for name in _HELD}
    return {**numbers, **held, "loose": np.zeros(n), "bounded": np.zeros(M, dtype=np.int32)}


def _table(n: int, m: int) -> dict[str, Array]:
    return {
        name: np.zeros((2 if name in ("bound", "side", "elastic") else 1) * (m + n))
        for name in _TABLE
    }


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
