"""Water of spheres, cylinders and boxes by the laws of uuv_simulator, whose models of these types state
sizes in place of coefficients.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from uvms_ocp.robot.description import Cylinder, as_matrix6
from uvms_ocp.robot.urdf_elements import Element, to_float

SIZES: Mapping[str, tuple[str, ...]] = {
    "fossen": (),
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
    "box": ("length", "width", "height"),
}
"""Types of models that are read, with the sizes [m] that they state."""
OPTIONS: Mapping[str, tuple[str, ...]] = {"cylinder": ("axis",), "box": ("cd",)}
"""Other elements of models, by their type."""
_SPHERE_DRAG = 0.5
# Drag coefficients of a cylinder by the largest length over diameter that has them.
_END_DRAG = ((1.0, 0.91), (2.0, 0.85), (4.0, 0.87), (np.inf, 0.99))
_SIDE_DRAG = ((1.0, 0.63), (2.0, 0.68), (5.0, 0.74), (10.0, 0.82), (np.inf, 0.98))
_BOX_DRAG = 1.0  # where a model states none
_AXES = ("i", "j", "k")


def missing_sizes(model: Element) -> list[str]:
    """Return what a model of a type of `SIZES` does not state: sizes above 0, the axis of a cylinder."""
    kind = model.findtext("type", "").strip()
    missing = [word for word in SIZES[kind] if not 0.0 < _number(model, word) < np.inf]
    if kind == "cylinder" and model.findtext("axis", "").strip() not in _AXES:
        missing.append("axis")
    return missing


def shaped_water(model: Element, stated: Mapping[str, Any], density: float) -> dict[str, Any]:
    """Return the coefficients that a model has by its sizes, in water of a density [kg/m3]: added mass
    and quadratic drag (6,), in the axes of the link.

    stated: coefficients beside the sizes, which count where the shape has none.
    """
    kind = model.findtext("type", "").strip()
    drag = _diagonal(stated.get("quadratic_drag"))
    if kind == "box":
        drag[:3] = _box_drag(model, density)
        return {"quadratic_drag": tuple(drag.tolist())}
    added = _diagonal(stated.get("added_mass"))
    if kind == "sphere":
        radius = _number(model, "radius")
        added[:3] = 2.0 / 3.0 * np.pi * density * radius**3
        drag[:3] = 0.5 * density * _SPHERE_DRAG * np.pi * radius**2
    else:
        _set_cylinder(model, density, added, drag)
    return {"added_mass": tuple(added.tolist()), "quadratic_drag": tuple(drag.tolist())}


def _set_cylinder(model: Element, density: float, added: np.ndarray, drag: np.ndarray) -> None:
    """Write added mass and drag (6,) of a cylinder; along it, its added mass is that of our cylinders.

    The simulator takes one radius as the width of the side, half of it.
    """
    radius = _number(model, "radius")
    length = _number(model, "length")
    axis = _AXES.index(model.findtext("axis", "").strip())
    across = [k for k in range(3) if k != axis]
    water = density * np.pi * radius**2 * length  # [kg] that it displaces
    ratio = length / (2.0 * radius)
    added[across] = water
    added[axis] = Cylinder(radius=radius, length=length).axial_added_mass * water
    added[[3 + k for k in across]] = water * length**2 / 12.0
    drag[across] = 0.5 * density * _at(_SIDE_DRAG, ratio) * radius * length
    drag[axis] = 0.5 * density * _at(_END_DRAG, ratio) * np.pi * radius**2


def _box_drag(model: Element, density: float) -> np.ndarray:
    """Return the drag (3,) of the faces of a box; its length is along x, its width along y."""
    coefficient = _number(model, "cd") if model.find("cd") is not None else _BOX_DRAG
    length = _number(model, "length")
    width = _number(model, "width")
    height = _number(model, "height")
    areas = np.array([width * height, length * height, length * width])  # [m2]
    return np.asarray(0.5 * density * coefficient * areas)


def _at(table: tuple[tuple[float, float], ...], ratio: float) -> float:
    """Return the coefficient of the first row whose limit is no less than the ratio."""
    return next(coefficient for limit, coefficient in table if ratio <= limit)


def _diagonal(values: Any) -> np.ndarray:
    """Return the diagonal (6,) of coefficients as a file states them; 0 where it states none."""
    if values is None:
        return np.zeros(6)
    return np.array(np.diag(as_matrix6(values)), dtype=float)


def _number(model: Element, word: str) -> float:
    return to_float(model.findtext(word, "").strip())
