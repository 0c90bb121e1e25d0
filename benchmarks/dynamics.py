"""Time per Python call of the dynamics in water, as a JSON table on stdout."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.model.dynamics import Dynamics, robot_dynamics
from uvms_ocp.model.files.library import list_robots
from uvms_ocp.model.loading import load_robot
from uvms_ocp.model.water.hydrodynamics import Water

N_CALLS, N_REPEATS = 1000, 20


def calls(dynamics: Dynamics) -> dict[str, Callable[[], object]]:
    """One call of each kind, at a random state in water that moves differently at every link."""
    rng, model = np.random.default_rng(0), dynamics.symbolic.model
    q = pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv))
    v, a = rng.normal(size=(2, model.nv))
    u, u_dot = rng.normal(size=(2, len(dynamics.symbolic.links), 3))
    water = Water(velocity=u, acceleration=u_dot)
    return {
        "inverse_dynamics": lambda: dynamics.inverse_dynamics(q, v, a, water),
        "forward_dynamics": lambda: dynamics.forward_dynamics(q, v, a, water),
        "bias_force": lambda: dynamics.bias_force(q, v, water),
        "mass_matrix": lambda: dynamics.mass_matrix(q),
        "damping_matrix": lambda: dynamics.damping_matrix(q, v, water),
    }


def microseconds(call: Callable[[], object]) -> dict[str, float]:
    """Median and worst mean over batches [us]."""
    batches = [_batch(call) for _ in range(N_REPEATS)]
    return {"p50_us": round(float(np.median(batches)), 2), "max_us": round(max(batches), 2)}


def _batch(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    for _ in range(N_CALLS):
        call()
    return (time.perf_counter() - start) / N_CALLS * 1e6


def rows() -> list[dict[str, object]]:
    """One row per robot and call."""
    return [
        {"robot": name, "n_v": dynamics.symbolic.model.nv, "call": what, **microseconds(call)}
        for name in list_robots()
        for dynamics in [robot_dynamics(load_robot(name))]
        for what, call in calls(dynamics).items()
    ]


if __name__ == "__main__":
    versions = {"casadi": ca.__version__, "pin": pin.__version__, "numpy": np.__version__}
    json.dump({"versions": versions, "rows": rows()}, sys.stdout, indent=1)
