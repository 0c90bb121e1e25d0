"""Judge a motion by its problem alone, whoever made it.

What a plan is called comes from this: by how much the laws of motion, limits and constraints are
left at the nodes and between them (`uvms_ocp.ocp.motion_check`), how far each level is from its
goal, and by how much one more step of another library would still lower it, with levels above it
held (`uvms_ocp.ocp.first_order_gain`). Nothing is known of the solver: neither its status, nor its
multipliers, planes or scalings. See the guide on optimal control for what each status promises.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from uvms_ocp.checks import checked
from uvms_ocp.ocp.first_order_gain import LevelGain, LinearizedMotion
from uvms_ocp.ocp.motion_check import motion_check
from uvms_ocp.ocp.node_margins import NO_TIGHTENING, Tightening
from uvms_ocp.ocp.plan_file import LevelVerdict, VerdictReport
from uvms_ocp.ocp.plan_status import OcpStatus
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem
from uvms_ocp.ocp.range_check import MotionCheck, Peak, RangeCheck, RangeKind
from uvms_ocp.ocp.stagewise.program import stagewise_or
from uvms_ocp.ocp.tolerances import TOLERANCES
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.ocp.transcription.actuation import ActuationModel
from uvms_ocp.ocp.transcription.transcription import Transcription
from uvms_ocp.solvers.nlp.options import IPOPT
from uvms_ocp.types import Array, Finite

_FORCE_LIMITS = (RangeKind.THRUST, RangeKind.TORQUE)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Verdict:
    """Verdict on a motion, and the evidence."""

    status: OcpStatus
    """SOLVED, IMPROVABLE, BROKEN or MISSED; why a goal is missed, or nothing keeps the constraints,
    is found by longer searches than this.
    """
    reason: str
    """Reason of the status in words, with numbers."""
    broken: tuple[RangeCheck, ...]
    """Ranges that are left by more than their tolerance."""
    check: MotionCheck
    """Excess over ranges, at nodes and between them."""
    report: VerdictReport
    """The part of the verdict that a plan keeps."""

    @property
    def missed(self) -> int | None:
        """Number of the first level whose goal is missed."""
        return _first(level.missed for level in self.report.levels)

    @property
    def improvable(self) -> int | None:
        """Number of the first level that a step would improve by more than the tolerance."""
        return _first(not level.optimal for level in self.report.levels)


def _first(flags: Iterable[bool]) -> int | None:
    """Return the index of the first that is True."""
    for i, flag in enumerate(flags):
        if flag:
            return i
    return None


@checked
def judge_motion(
    problem: OcpProblem,
    trajectory: Trajectory,
    *,
    t0: Finite = 0.0,
    transcription: Transcription | None = None,
    tightened: Tightening = NO_TIGHTENING,
) -> Verdict:
    """Judge a trajectory of as many steps as the problem has.

    t0 [s]: time of the first node, for goals and obstacles that move. transcription: of a problem
    of the same shape, which else is built; whoever shares it with a planner holds its `turn`.
    tightened: what nodes were asked for beyond their ranges so that these are kept between nodes;
    the gain of a step is that of motions which do so as well. Raises `InvalidInput` for another
    number of steps.
    """
    if transcription is None:
        transcription = Transcription(problem, plugin=stagewise_or(IPOPT, problem))
    motion = LinearizedMotion(
        transcription=transcription,
        problem=problem,
        trajectory=trajectory,
        t0=t0,
        tightened=tightened,
    )
    check = motion_check(problem, trajectory, t0=t0)
    broken = tuple(item for item in check.ranges if _excess(item, problem) > 1.0)
    levels = []
    for level, gain in zip(problem.levels, motion.gains(TOLERANCES.gain), strict=True):
        has_levels_below = level is not problem.levels[-1]
        levels.append(_level_verdict(level, gain, has_levels_below=has_levels_below))
    unseen = max((_unseen(item, problem) for item in check.ranges), default=0.0)
    report = VerdictReport(
        tolerances=TOLERANCES,
        levels=tuple(levels),
        time_resolution=check.time_resolution,
        unseen=unseen if np.isfinite(unseen) else None,
    )
    status, reason = _status(broken, report.levels)
    return Verdict(status=status, reason=reason, broken=broken, check=check, report=report)


def _status(
    broken: tuple[RangeCheck, ...], levels: tuple[LevelVerdict, ...]
) -> tuple[OcpStatus, str]:
    """Return the status and the reason for it."""
    if broken:
        return OcpStatus.BROKEN, "; ".join(describe_broken(item) for item in broken)
    missed = _first(level.missed for level in levels)
    if missed is not None:
        return OcpStatus.MISSED, describe_missed(levels[missed])
    improvable = _first(not level.optimal for level in levels)
    if improvable is not None:
        return OcpStatus.IMPROVABLE, describe_gain(levels[improvable])
    return OcpStatus.SOLVED, "all goals are met"


def describe_broken(item: RangeCheck) -> str:
    """Say by how much a range is left, and where."""
    is_at_nodes = item.at_nodes.amount >= item.between.amount
    peak = item.worst
    place = "at" if is_at_nodes else "between nodes, at"
    name = f"{item.name} ({peak.quantity})" if peak.quantity else item.name
    return f"{name} is broken by {peak.amount:.3g} {item.unit} {place} {peak.time:.3g} s"


def describe_missed(level: LevelVerdict) -> str:
    """Say how far a level is from its goal."""
    return f"level {level.name!r} is missed by {level.residual:.4g}"


def describe_gain(level: LevelVerdict) -> str:
    """Say by how much a level could still be lower."""
    if level.gain is None:
        return f"level {level.name!r}: it is not known whether a step would lower its residual"
    return (
        f"level {level.name!r}: one more step would lower its residual of {level.residual:.4g} by"
        f" {level.gain / level.residual:.2%}"
    )


def _level_verdict(level: OcpLevel, step: LevelGain, *, has_levels_below: bool) -> LevelVerdict:
    """Judge a level by the gain that a step promises."""
    gain = step.gain
    if level.relax is not None and has_levels_below:
        gain = _gain_beyond(step, level.relax)
    missed = is_missed(level, step.residual)
    is_known = bool(np.isfinite(gain))
    is_met = all(term.is_goal for term in level.terms) and not missed
    negligible_gain = max(TOLERANCES.gain * step.residual, TOLERANCES.gain_floor)
    return LevelVerdict(
        name=level.name,
        residual=step.residual,
        gain=gain if is_known else None,
        missed=missed,
        optimal=is_met or bool(gain <= negligible_gain),
    )


def is_missed(level: OcpLevel, residual: float) -> bool:
    """Check whether goals of a level are left: a small weight says what a goal is worth beside
    others, not that it is met. A residual that is no number is missed.
    """
    weights = [term.weight for term in level.terms if term.is_goal]
    if not weights:
        return False
    return not residual <= TOLERANCES.goal * min(1.0, *weights) ** 0.5


def _gain_beyond(step: LevelGain, relax: float) -> float:
    """Reduce the gain of a step by what a level may rise for the sake of levels below it: to
    (1 + relax) times the least cost.
    """
    if not np.isfinite(step.gain):
        return step.gain
    allowed = (1.0 + relax) ** 0.5 * max(step.residual - step.gain, 0.0)
    return max(step.residual - allowed, 0.0)


def _excess(item: RangeCheck, problem: OcpProblem) -> float:
    """Return the largest amount by which a range is left, as a multiple of its tolerance."""
    nodes = _multiple(item, item.at_nodes, problem, between=False)
    return max(nodes, _multiple(item, item.between, problem, between=True))


def _multiple(item: RangeCheck, peak: Peak, problem: OcpProblem, *, between: bool) -> float:
    if not peak.amount > 0.0:
        return 0.0
    row = item.quantities.index(peak.quantity)
    return peak.amount / float(_tolerances(item, problem, between=between)[row])


def _unseen(item: RangeCheck, problem: OcpProblem) -> float:
    """Return a bound of what may be left unseen beyond what was seen, as a multiple of the
    tolerance.
    """
    if not item.resolution > 0.0:
        return 0.0
    return item.resolution / float(_tolerances(item, problem, between=True).max())


def _tolerances(item: RangeCheck, problem: OcpProblem, *, between: bool) -> Array:
    """Return by how much (m,) [unit of the quantity] ranges may be left."""
    m = len(item.quantities)
    if item.kind is RangeKind.MOTION:
        return np.full(m, TOLERANCES.motion)
    if item.kind is RangeKind.FORCES:
        return TOLERANCES.forces * _force_units(problem)
    if item.kind in _FORCE_LIMITS:
        share = TOLERANCES.force_between if between else TOLERANCES.forces
        largest = np.maximum(np.abs(item.lower), np.abs(item.upper))
        return share * np.where(np.isfinite(largest) & (largest > 0.0), largest, 1.0)
    if item.kind is RangeKind.CLEARANCE:
        return np.full(m, TOLERANCES.clearance)
    return np.full(m, TOLERANCES.ranges)


def _force_units(problem: OcpProblem) -> Array:
    """Return the most that actuators give on every axis (n_v,) [N, N m]."""
    actuators = ActuationModel(problem.robot, problem.actuation)
    largest = np.abs(actuators.matrix) @ actuators.thrust_unit
    vehicle = np.maximum(largest, 1e-3 * (largest.max(initial=0.0) or 1.0))
    return np.concatenate([vehicle, actuators.torque_unit])
