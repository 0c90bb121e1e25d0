"""Data of one QP and the linear algebra on it, by the compiled core or by its NumPy twin."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import asdict
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.functions.compile import compile_library, loaded_library
from uvms_ocp.solvers.stagewise.shape import StageShape, places
from uvms_ocp.solvers.stagewise.stage_qp import StageQp
from uvms_ocp.solvers.stagewise.tolerances import STAGE_TOLERANCES

_INCLUDES = "#include <math.h>\n#include <stddef.h>\n#include <string.h>\n"
_SOURCES = ("blocks.c", "riccati.c")
_FLAGS = ("-O2", "-ftree-vectorize")
_SIZES = ("n_x", "n_u", "n_r", "n_c")
_PLACES = ("x", "z", "r", "c", "F", "J", "H", "C", "M")
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
_WORK = ("fixed", "Q", "q", "L", "inverse", "W", "v", "list")


class _Stages(ctypes.Structure):
    """As `Stages` in riccati.c."""

    _fields_ = (
        ("N", ctypes.c_int),
        *((name, ctypes.c_void_p) for name in (*_SIZES, *_PLACES, *_DATA, *_WORK)),
        ("least", ctypes.c_double),
    )


def padded(n: int) -> int:
    """Columns [-] of an own matrix of n [-]."""
    return (n + 3) // 4 * 4


class CompiledStages:
    """The core of riccati.c, on memory of its own and the data of a QP."""

    def __init__(self, library: ctypes.CDLL, shape: StageShape) -> None:
        self.shape, self._kept = shape, {**_integers(shape), **_work(shape)}
        self.fixed, self.q = self._kept["fixed"], self._kept["q"]
        self._stages = _Stages(N=shape.N)
        for name, array in self._kept.items():
            setattr(self._stages, name, array.ctypes.data)
        self._library = library

    def load(self, qp: StageQp, *, costless: bool = False) -> float:
        """Take the data over and make the Hessian, without the cost of `costless`; the largest curvature [1/unit of z^2]."""
        for name, given in _DATA.items():
            setattr(self._stages, name, qp.flat[given].ctypes.data)
        self._library.load_stages(ctypes.byref(self._stages), int(costless))
        return float(self._stages.least / STAGE_TOLERANCES.smallest_curvature)

    def factor(self, weight: Array, weight_z: Array) -> int:
        return int(self._library.factor_stages(ctypes.byref(self._stages), _at(weight), _at(weight_z)))

    def solve(self, g: Array, d: Array) -> tuple[Array, Array]:
        dz, costate = np.empty(sum(self.shape.n_z)), np.empty(sum(self.shape.n_x))
        self._library.solve_stages(ctypes.byref(self._stages), _at(g), _at(d), _at(dz), _at(costate))
        return dz, costate

    def evaluate(self, z: Array, costate: Array, y: Array, y_z: Array) -> tuple[Array, Array, Array, float]:
        """Gradient of the Lagrangian, defects, values of rows, and the largest term of the gradient."""
        grad, defect, value = np.empty(len(z)), np.empty(len(costate)), np.empty(len(y))
        given = [_at(array) for array in (z, costate, y, y_z, grad, defect, value)]
        largest = self._library.evaluate_stages(ctypes.byref(self._stages), 1, *given)
        return grad, defect, value, float(largest)

    def values(self, z: Array) -> Array:
        value = np.empty(sum(self.shape.n_c))
        self._library.constraint_values(ctypes.byref(self._stages), _at(z), _at(value))
        return value

    def add_transposed(self, y: Array, y_z: Array, grad: Array) -> Array:
        """(n,) grad + C' y + y_z."""
        grad = grad.copy()
        self._library.add_transposed(ctypes.byref(self._stages), _at(y), _at(y_z), _at(grad))
        return grad


def _at(array: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def compiled_stages(shape: StageShape) -> CompiledStages | None:
    """None without a compiler."""
    library = _library()
    return None if library is None else CompiledStages(library, shape)


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL | None:
    path = compile_library(core_source(), _FLAGS, "QPs of stages")
    if path is None:
        return None
    library = loaded_library(path)
    library.evaluate_stages.restype = ctypes.c_double
    return library


def core_source() -> str:
    """C99 source of the linear algebra; needs libm only and allocates nothing."""
    folder = files("uvms_ocp.solvers.stagewise")
    texts = (folder.joinpath(name).read_text(encoding="utf-8") for name in _SOURCES)
    return "\n".join([_INCLUDES, _macros(asdict(STAGE_TOLERANCES)), *texts])


def _macros(values: Mapping[str, object]) -> str:
    return "".join(f"#define {name.upper()} {value}\n" for name, value in values.items())


def _integers(shape: StageShape) -> dict[str, Any]:
    n_x, n_z, n_r, n_c = shape.n_x, shape.n_z, shape.n_r, shape.n_c
    sizes = {
        "x": n_x,
        "z": n_z,
        "r": n_r,
        "c": n_c,
        "F": [m * n for m, n in zip(n_x[1:], n_z, strict=False)],
        "J": [m * n for m, n in zip(n_r, n_z, strict=True)],
        "H": [n * n for n in n_z],
        "C": [m * n for m, n in zip(n_c, n_z, strict=True)],
        "M": [padded(n) ** 2 for n in n_z],
    }
    given = {name: np.array((*getattr(shape, name), 0), dtype=np.int32) for name in _SIZES}
    return {**given, **{name: np.array(places(size), dtype=np.int32) for name, size in sizes.items()}}


def _work(shape: StageShape) -> dict[str, Array]:
    n, most, factor = sum(shape.n_z), padded(max(shape.n_z)), sum(padded(n) ** 2 for n in shape.n_z)
    sizes = {
        "fixed": n,
        "Q": factor,
        "q": n,
        "L": factor,
        "inverse": n,
        "W": padded(max(shape.n_x)) * most + 4,
        "v": 4 * most,
        "list": 4 * max(*shape.n_r, *shape.n_c, 1),
    }
    return {name: np.zeros(size) for name, size in sizes.items()}
