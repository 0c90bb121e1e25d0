"""What no input can bring within the limits in the first step: a proof, before any NLP, that a start is impossible."""

from __future__ import annotations

import numpy as np

from uvms_ocp.planning.ocp import OcpProblem

_ROUNDING = 1e-9


def impossible_start(problem: OcpProblem) -> str | None:
    """An axis whose limits the second node cannot keep, in words; None where every axis can.

    Velocity changes by at most the acceleration limit times the step, and a joint goes on meanwhile. These are limits
    of single axes: where they can be kept, forces, constraints or goals may still be out of reach.
    """
    if not problem.limited:
        return None
    phase = problem.phases[0]
    h = phase.range[1] / phase.n_steps
    return _too_fast(problem, h) or _too_near(problem, h)


def _too_fast(problem: OcpProblem, h: float) -> str | None:
    limits, v = problem.robot.limits, problem.start.v
    excess = np.abs(v) - limits.acceleration * h - limits.velocity
    i = int(np.argmax(excess))
    if excess[i] <= _ROUNDING:
        return None
    return (
        f"{_axes(problem)[i]} starts at {v[i]:.4g} and must not exceed {limits.velocity[i]:.4g} after the first step: in "
        f"{h:.3g} s it changes by {limits.acceleration[i] * h:.4g} at most"
    )


def _too_near(problem: OcpProblem, h: float) -> str | None:
    robot, limits = problem.robot, problem.robot.limits
    for joint in robot.joints:
        if joint.n_q != joint.n_v:
            continue
        for i in range(joint.n_v):
            q, v = float(problem.start.q[joint.q][i]), float(problem.start.v[joint.idx_v + i])
            a, speed = limits.acceleration[joint.idx_v + i], limits.velocity[joint.idx_v + i]
            own = joint.idx_v - robot.n_vehicle + i
            least = q + h * (v + max(v - a * h, -speed)) / 2
            most = q + h * (v + min(v + a * h, speed)) / 2
            low, high = limits.position_lower[own], limits.position_upper[own]
            if least > high + _ROUNDING or most < low - _ROUNDING:
                return (
                    f"joint {joint.name!r} starts at {q:.4g} with {v:.4g} per second and cannot stay between {low:.4g} "
                    f"and {high:.4g} in the first step of {h:.3g} s"
                )
    return None


def _axes(problem: OcpProblem) -> list[str]:
    vehicle = ("surge", "sway", "heave", "roll rate", "pitch rate", "yaw rate")[: problem.robot.n_vehicle]
    return [*vehicle, *(f"rate of {name!r}" for name in problem.robot.joint_names)]
