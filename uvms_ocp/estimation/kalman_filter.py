"""Run one tick of the Kalman filter, in C where there is a compiler and in NumPy elsewhere, with the same numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from enum import IntEnum
from functools import lru_cache, partial
from importlib.resources import files

import casadi as ca
import numpy as np

from uvms_ocp.codegen.buffered import BoundFunction
from uvms_ocp.codegen.compile import c_macros, external_function
from uvms_ocp.estimation import joint_filters as joints
from uvms_ocp.estimation import measurement_update as fusion
from uvms_ocp.estimation import vehicle_model as vehicle
from uvms_ocp.estimation.filter_memory import (
    CONSTANTS,
    JOINT_SLOTS,
    JOINT_STATES,
    MAIN,
    N_CHANNELS,
    N_VEHICLE,
    ORDERS,
    ROWS,
    SLOTS,
    STATES,
    ChannelIndex,
    FilterMemory,
    Part,
    ProcessNoise,
    places,
)
from uvms_ocp.estimation.vehicle_model import predict_measurement

_INCLUDES = "#include <math.h>\n#include <string.h>\n"
_SOURCES = ("motion.c", "clones.c", "sights.c", "fusion.c", "joints.c", "entry.c")
_CODES = {"CHANNEL": ChannelIndex, "PART": Part, "NOISE": ProcessNoise}
_SIZES = {
    "MAIN": MAIN,
    "SLOTS": SLOTS,
    "STATES": STATES,
    "JOINT_SLOTS": JOINT_SLOTS,
    "JOINT_STATES": JOINT_STATES,
    "N_CHANNELS": N_CHANNELS,
    "N_VEHICLE": N_VEHICLE,
    "ROW_COUNTS": ", ".join(map(str, ROWS)),
    "ORDER_COUNTS": ", ".join(map(str, ORDERS)),
}


def bound_tick(memory: FilterMemory, *, compiled: bool = True) -> Callable[[], None]:
    """Return a call that advances the filter in `memory` to its `now`; NumPy unless `compiled`, or without a compiler."""
    core = _core(memory.n_joints) if compiled else None
    if core is None:
        return partial(numpy_tick, memory)
    # In and out are one: a covariance of this size is not copied at every tick.
    return BoundFunction(core, [memory.numbers], [memory.numbers])


def numpy_tick(m: FilterMemory) -> None:
    """Run one tick in NumPy, as entry.c does; keep both in step."""
    m.dt[0] = m.now[0] - m.before[0] if m.started[0] else 0.0
    m.started[0], m.before[0] = 1.0, m.now[0]
    if m.floating[0]:
        vehicle.predict(m)
        fusion.fuse(m)
        _write_vehicle_outputs(m)
    joints.predict(m)
    joints.fuse(m)
    m.std[6:] = np.sqrt(np.maximum(0.0, m.joint_P[:, 0, 0]))
    late = m.now[0] - np.where(m.needed > 0.0, m.used, np.inf)
    m.age[:] = max(0.0, late.max()), max(0.0, m.now[0] - m.used[ChannelIndex.JOINT_POSITIONS])
    m.fresh[:] = 0.0


def _write_vehicle_outputs(m: FilterMemory) -> None:
    m.twist[:3] = vehicle.rotation(m).T @ vehicle.part(m, Part.SPEED)
    m.twist[3:] = vehicle.part(m, Part.SPIN)
    sigma = np.sqrt(np.maximum(0.0, np.diag(m.P)[:6]))
    m.std[:3], m.std[3:6] = sigma[3:], sigma[:3]
    sight = predict_measurement(m, ChannelIndex.ALTIMETER_RANGE)
    altitude, cosine = sight.h[:2]
    has_floor = cosine > CONSTANTS.steep and m.now[0] - m.echo[0] <= m.echo_memory[0]
    m.range[:] = (altitude / cosine, np.sqrt(max(0.0, sight.S[0, 0])) / cosine) if has_floor else np.nan


def core_source(n_joints: int) -> str:
    """Write the C source of the filter of a robot with that many joints; needs libm only."""
    folder = files("uvms_ocp.estimation")
    offsets, size = places(n_joints)
    views = "".join(f"#define m_{name} (m + {start})\n" for name, (start, _) in offsets.items())
    parts = [
        _INCLUDES,
        c_macros({**_SIZES, "N_JOINTS": n_joints, "SIZE": size, **asdict(CONSTANTS)}),
        views,
        *(_enumeration(prefix, codes) for prefix, codes in _CODES.items()),
        *(folder.joinpath(name).read_text(encoding="utf-8") for name in _SOURCES),
    ]
    return "\n".join(parts)


def _enumeration(prefix: str, codes: type[IntEnum]) -> str:
    return f"enum {{ {', '.join(f'{prefix}_{code.name} = {code.value}' for code in codes)} }};\n"


@lru_cache(maxsize=16)
def _core(n_joints: int) -> ca.Function | None:
    return external_function("navigation_filter", core_source(n_joints))
