"""Room for the pairs of collision models in the memories of a tick, whose kernels measure them where they can."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import casadi as ca

from uvms_ocp.model.robot import Robot
from uvms_ocp.model.shapes.collision_model import CollisionModel
from uvms_ocp.model.shapes.distance_kernels.clear_pairs import distance_sizes


def in_c(model: CollisionModel, robot: Robot | None) -> bool:
    """Whether kernels measure its pairs: all of them have machine code, and are on this robot."""
    return robot is not None and not model.by_coal and model.is_of(robot)


def distance_room(models: Iterable[CollisionModel], robot: Robot | None) -> dict[str, Any]:
    """What `structure_of` layouts with a `DistanceMemory` for any of the models needs; Python measures those not `in_c`."""
    known = list(models)
    n_pairs = max((model.n_pairs for model in known), default=0)
    measured = [model.n_solids for model in known if in_c(model, robot)]
    if robot is None or not measured:
        n_v = max([model.n_v for model in known] if robot is None else [robot.n_v], default=0)
        # Room for all axes, also where none is looked at: compilers see what a kernel could read.
        return {"places": _nothing(), "n_placements": 12, "n_twists": 6 * n_v, "n_solids": 1, "n_pairs": n_pairs}
    return distance_sizes(robot.model, n_solids=max(measured), n_pairs=n_pairs)


def without_c_form(model: CollisionModel, robot: Robot | None) -> str:
    """What keeps kernels from measuring the pairs even where there is a compiler; empty where nothing does."""
    if model.without_c_form:
        return f"distances of {', '.join(model.without_c_form)}; spheres, capsules, cylinders and boxes have"
    return "" if robot is not None and model.is_of(robot) else "distances of another robot"


def _nothing() -> ca.Function:
    q = ca.SX.sym("q")
    return ca.Function("places", [q], [ca.SX(ca.DM.zeros(1)), ca.SX(ca.DM.zeros(1))])
