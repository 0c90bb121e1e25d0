"""What no input can bring within the limits in the first step: a proof, before any NLP, that a start is impossible."""

from __future__ import annotations

import numpy as np

from uvms_ocp.ocp.problem import OcpProblem

_ROUNDING = 1e-9


def impossible_start(problem: OcpProblem) -> str | None:
    """An axis whose limits the second node cannot keep, in words; None where every axis can.

    Velocity changes by at most the acceleration limit times the step, and a joint goes on meanwhile. These are limits
    of single axes: where they can be kept, forces, constraints or goals may still be out of reach. A free duration
    counts as impossible only if every step in its range is.
    """
    if not (problem.limited and problem.fixed_start):
        return None
    phase = problem.phases[0]
    shortest, longest = (duration / phase.n_steps for duration in phase.range)
    return _too_fast(problem, longest) or _too_near(problem, shortest, longest)


def _too_fast(problem: OcpProblem, h: float) -> str | None:
    """After the longest step, which leaves the most time to slow down."""
    limits, v = problem.robot.limits, problem.start.v
    excess = np.abs(v) - limits.acceleration * h - limits.velocity
    i = int(np.argmax(excess))
    if excess[i] <= _ROUNDING:
        return None
    return (
        f"{_axes(problem)[i]} starts at {v[i]:.4g} and must not exceed {limits.velocity[i]:.4g} after the first step: in "
        f"{h:.3g} s it changes by {limits.acceleration[i] * h:.4g} at most"
    )


def _too_near(problem: OcpProblem, shortest: float, longest: float) -> str | None:
    """After the best step: a short one does not get to the limit, a long one may have turned back."""
    robot, limits = problem.robot, problem.robot.limits
    for joint in robot.joints:
        if joint.n_q != joint.n_v:
            continue
        for i in range(joint.n_v):
            q, v = float(problem.start.q[joint.q][i]), float(problem.start.v[joint.idx_v + i])
            a, speed = limits.acceleration[joint.idx_v + i], limits.velocity[joint.idx_v + i]
            own = joint.idx_v - robot.n_vehicle + i
            least = q + _least_way(v, a, speed, shortest, longest)
            most = q - _least_way(-v, a, speed, shortest, longest)
            low, high = limits.position_lower[own], limits.position_upper[own]
            if least > high + _ROUNDING or most < low - _ROUNDING:
                return (
                    f"joint {joint.name!r} starts at {q:.4g} with {v:.4g} per second and cannot stay between {low:.4g} "
                    f"and {high:.4g} in the first step of {_range(shortest, longest)} s"
                )
    return None


def _least_way(v: float, a: float, speed: float, shortest: float, longest: float) -> float:
    """Smallest displacement after any step in the range; concave in the step but for where the speed limit is met."""
    kink = (v + speed) / a if np.isfinite(a) else 0.0
    steps = (shortest, longest, min(max(kink, shortest), longest))
    return min(h * (v + max(v - a * h, -speed)) / 2 for h in steps)


def _range(shortest: float, longest: float) -> str:
    return f"{longest:.3g}" if shortest == longest else f"{shortest:.3g} to {longest:.3g}"


def _axes(problem: OcpProblem) -> list[str]:
    vehicle = ("surge", "sway", "heave", "roll rate", "pitch rate", "yaw rate")[: problem.robot.n_vehicle]
    return [*vehicle, *(f"rate of {name!r}" for name in problem.robot.joint_names)]
