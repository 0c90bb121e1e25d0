"""One tick of the Kalman filter, as a kernel: from the inputs in its memory to the outputs there."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

from uvms_ocp.codegen.kernel_layout import zeros
from uvms_ocp.codegen.kernels import bind_kernels
from uvms_ocp.estimation.filter_memory import MAIN, N_CHANNELS, ChannelIndex, FilterMemory, Part
from uvms_ocp.estimation.joint_filters import fuse_joints, predict_joints
from uvms_ocp.estimation.measurement_update import fuse
from uvms_ocp.estimation.vehicle_model import predict, predict_measurement, rotate_back, rotation
from uvms_ocp.robot.kinematics import STEEP


def bound_tick(memory: FilterMemory, *, compiled: bool = True) -> Callable[[], None]:
    """A call that advances the filter in `memory` to its `now`; in Python unless `compiled`, or without a compiler."""
    (tick,) = bind_kernels((advance_filter,), (type(memory),), compiled=compiled)
    return partial(tick, memory)


def advance_filter(m: FilterMemory) -> None:
    """Run one tick: predict, fuse what is fresh, and write the outputs."""
    m.dt = m.now - m.before if m.started else 0.0
    m.started = True
    m.before = m.now
    if m.floating:
        predict(m)
        fuse(m)
        _write_vehicle_outputs(m)
    predict_joints(m)
    fuse_joints(m)
    for j in range(m.n_joints):
        m.std[6 + j] = math.sqrt(max(m.joint_P[j][0][0], 0.0))
    m.age[0] = 0.0
    m.age[1] = max(m.now - m.used[ChannelIndex.JOINT_POSITIONS], 0.0)
    for c in range(N_CHANNELS):
        if m.needed[c] > 0.0:
            m.age[0] = max(m.now - m.used[c], m.age[0])
        m.fresh[c] = 0.0


def _write_vehicle_outputs(m: FilterMemory) -> None:
    R, s = zeros(9), m.predicted
    rotation(m.turn, R)
    rotate_back(R, m.x, Part.SPEED, m.twist)
    for i in range(3):
        m.twist[3 + i] = m.x[Part.SPIN + i]
        m.std[i] = math.sqrt(max(m.P[Part.PLACE + i][Part.PLACE + i], 0.0))
        m.std[3 + i] = math.sqrt(max(m.P[Part.TURN + i][Part.TURN + i], 0.0))
    predict_measurement(m, ChannelIndex.ALTIMETER_RANGE, MAIN)
    has_floor = s.h[1] > STEEP and m.now - m.echo <= m.echo_memory
    m.range[0] = s.h[0] / s.h[1] if has_floor else math.nan
    m.range[1] = math.sqrt(max(s.S[0][0], 0.0)) / s.h[1] if has_floor else math.nan
