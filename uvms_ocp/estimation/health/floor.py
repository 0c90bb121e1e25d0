"""Check altimeter echoes against the floor seen so far and the motion of the vehicle.

Every echo is compared with the floor that echoes showed nearby. A floor that is nearer is accepted
at once, as the safe case. One that is farther away is accepted when echoes have agreed with each
other for a while in which the vehicle moved vertically, as an altimeter that is stuck shows a floor
that follows the vehicle, and horizontally, as floors do not sink. The floor that was seen before is
kept beside a new one, and accepted again after a few echoes.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized
from uvms_ocp.estimation.health.tuning import Complaint, HealthTuning, Reason, set_complaint

MAX_FLOOR_POINTS = 128
_STEEPEST = 0.6  # of a slope along which a beam runs down

POSITION = 0.1
"""[m] by which position, depth and floor may be wrong of a robot that manoeuvres in gusts, beside
noise.
"""
_SIGMAS = 8.0
_MEMORY = 60.0  # [s] for which an echo tells of the floor where it was taken
_SPACING = max(0.5, _MEMORY / (MAX_FLOOR_POINTS - 2))  # [s] between the echoes that are kept
# [s] for which echoes from a floor that is farther away agree before they are believed: twenty at
# 10 Hz
_STEP_TIME = 2.0
# [m] of vertical motion in that time, which a value that is stuck does not follow; ten times the
# noise
_STEP_TRAVEL = 0.2
_STEP_WAY = 0.3  # [m] of horizontal motion after which there may be another floor
_RETURN = 3  # echoes in a row from a floor known before that bring it back


class FloorPoint(Layout):
    """Point of the floor in W from which an echo came."""

    t: float
    """[s] time of the echo."""
    x: float
    """[m] x of the point."""
    y: float
    """[m] y of the point."""
    z: float
    """[m] z of the point."""
    sensor_x: float
    """[m] x of the altimeter."""
    sensor_y: float
    """[m] y of the altimeter."""
    sensor_z: float
    """[m] z of the altimeter."""
    lowest: float
    """[m] lowest place of the sensor until the next spot that is kept."""
    highest: float
    """[m] highest place of the sensor until the next spot that is kept."""


class FloorPoints(Layout):
    """Points of the floor in the order of time, in a ring."""

    first: int
    count: int
    kept: Annotated[list[FloorPoint], Sized(MAX_FLOOR_POINTS)]


def slot_of(floor_points: FloorPoints, k: int) -> int:
    """Return the slot of spot k, from the oldest."""
    return (floor_points.first + k) % len(floor_points.kept)


def append_floor_point(floor_points: FloorPoints, new: FloorPoint) -> None:
    """Keep a spot; where all places are taken the oldest goes."""
    if floor_points.count == len(floor_points.kept):
        forget_first(floor_points)
    _copy_spot(floor_points.kept[slot_of(floor_points, floor_points.count)], new)
    floor_points.count += 1


def forget_first(floor_points: FloorPoints) -> None:
    """Forget the oldest spot."""
    floor_points.first = (floor_points.first + 1) % len(floor_points.kept)
    floor_points.count -= 1


def forget_older(floor_points: FloorPoints, t: float) -> None:
    """Forget spots from before time t [s], the last one aside."""
    while floor_points.count > 1 and floor_points.kept[floor_points.first].t < t:
        forget_first(floor_points)


def keep_alone(floor_points: FloorPoints, new: FloorPoint) -> None:
    """Keep a spot and nothing before it."""
    floor_points.count = 0
    append_floor_point(floor_points, new)


def copy_floor_points(to: FloorPoints, source: FloorPoints) -> None:
    """Copy all points of the source."""
    to.first = to.count = 0
    for k in range(source.count):
        append_floor_point(to, source.kept[slot_of(source, k)])


def floor_step(accepted: FloorPoints, new: FloorPoint, base: float, slope: float) -> float:
    """Return by how much [m] the floor would rise from the known spot that fits least to a new one;
    0 where all fit.

    base [m]: that is nothing. slope: of the steepest floor.
    """
    worst = 0.0
    worst_excess = 0.0
    for k in range(accepted.count):
        old = accepted.kept[slot_of(accepted, k)]
        beyond = abs(new.z - old.z) - base
        if beyond > worst_excess:
            excess = beyond - height_allowance(new, old, slope)
            if excess > worst_excess:
                worst = new.z - old.z
                worst_excess = excess
    return worst


def height_allowance(new: FloorPoint, old: FloorPoint, slope: float) -> float:
    """Return by how much [m] the floor may rise or fall from an old spot to a new one; slope: of
    the steepest floor.

    A beam that goes deeper than the old spot has passed its level at a point near it or far from
    it: from there on both fall, and meet the later, the more the beam tilts.
    """
    dx = new.x - new.sensor_x
    dy = new.y - new.sensor_y
    fall = new.sensor_z - new.z
    if fall > 0.0 and new.sensor_z > old.z:
        share = min(1.0, (new.sensor_z - old.z) / fall)
    else:
        share = 1.0
    away = slope * _length(new.sensor_x + share * dx - old.x, new.sensor_y + share * dy - old.y)
    if share == 1.0:
        return away
    return away / (1.0 - min(slope * (_length(dx, dy) / fall), _STEEPEST))


def vertical_travel(floor_points: FloorPoints) -> float:
    """Return the height [m] between the lowest and the highest place of the sensor."""
    lowest = math.inf
    highest = -math.inf
    for k in range(floor_points.count):
        spot = floor_points.kept[slot_of(floor_points, k)]
        lowest = min(lowest, spot.lowest)
        highest = max(highest, spot.highest)
    return highest - lowest


def _length(x: float, y: float) -> float:
    return math.sqrt(x * x + y * y)


def _copy_spot(to: FloorPoint, new: FloorPoint) -> None:
    to.t = new.t
    to.x = new.x
    to.y = new.y
    to.z = new.z
    to.sensor_x = new.sensor_x
    to.sensor_y = new.sensor_y
    to.sensor_z = new.sensor_z
    to.lowest = new.sensor_z
    to.highest = new.sensor_z


class FloorMemory(Layout):
    """Memory of the floor by echoes so far, and of the steps that are possible."""

    base: float
    """[m] by which echoes of one place may differ."""
    slope: float
    """Slope of the steepest floor."""
    relief: float
    """[m] height of the highest step."""
    here: FloorPoint
    """Newest point of the floor."""
    accepted: FloorPoints
    before: FloorPoints
    candidates: FloorPoints
    """Spots of a floor that is farther away; each with the vertical motion until the next one."""
    returned: int


def init_floor(memory: FloorMemory, sigma: float, tuning: HealthTuning) -> None:
    """Prepare a `FloorMemory`; sigma [m]: noise of the altimeter."""
    memory.base = POSITION + _SIGMAS * sigma
    memory.slope = tuning.slope
    memory.relief = tuning.relief


def accept_echo(floor: FloorMemory, why: Complaint) -> bool:
    """Return whether to believe the echo from `here`, in order of time; write what speaks against
    it otherwise, or all the same, into `why`.
    """
    oldest = floor.here.t - _MEMORY
    candidates = floor.candidates
    forget_older(floor.accepted, oldest)
    forget_older(floor.before, oldest)
    if candidates.count > 1 and candidates.kept[candidates.first].t < oldest:
        forget_first(candidates)
    step = floor_step(floor.accepted, floor.here, floor.base, floor.slope)
    if step == 0.0:
        _accept(floor)
        return True
    if step > 0.0:
        if floor.before.count == 0:
            copy_floor_points(floor.before, floor.accepted)
        keep_alone(floor.accepted, floor.here)
        floor.candidates.count = floor.returned = 0
        set_complaint(why, Reason.NEARER, step, 0.0)
        return True
    if (
        floor.before.count > 0
        and floor_step(floor.before, floor.here, floor.base, floor.slope) == 0.0
    ):
        return _as_before(floor, step, why)
    floor.returned = 0
    return _farther(floor, step, why)


def is_farther(floor: FloorMemory) -> bool:
    """Return whether the echo from `here` shows a floor that is farther away than those so far, which
    it does not change.
    """
    return floor_step(floor.accepted, floor.here, floor.base, floor.slope) < 0.0


def _accept(floor: FloorMemory) -> None:
    accepted = floor.accepted
    if (
        accepted.count == 0
        or floor.here.t - accepted.kept[slot_of(accepted, accepted.count - 1)].t >= _SPACING
    ):
        append_floor_point(accepted, floor.here)
    floor.candidates.count = floor.returned = 0


def _as_before(floor: FloorMemory, step: float, why: Complaint) -> bool:
    floor.returned += 1
    if floor.returned < _RETURN:
        set_complaint(why, Reason.AS_BEFORE, -step, 0.0)
        return False
    copy_floor_points(floor.accepted, floor.before)
    floor.before.count = 0
    _accept(floor)
    return True


def _farther(floor: FloorMemory, step: float, why: Complaint) -> bool:
    if floor.candidates.count > 0 and not abs(
        floor.here.z - floor.candidates.kept[floor.candidates.first].z
    ) <= _tolerance(floor):
        floor.candidates.count = 0
    _add_candidate(floor)
    if _is_proven(floor, -step):
        keep_alone(floor.accepted, floor.here)
        floor.before.count = 0
        _accept(floor)
        return True
    set_complaint(why, Reason.FARTHER, -step, 0.0)
    return False


def _tolerance(floor: FloorMemory) -> float:
    """Return by how much [m] an echo of one floor may differ from the first one that was not
    believed.
    """
    return 0.5 * (
        floor.base
        + height_allowance(floor.here, floor.candidates.kept[floor.candidates.first], floor.slope)
    )


def _add_candidate(floor: FloorMemory) -> None:
    candidates, point = floor.candidates, floor.here
    if candidates.count > 0:
        last = candidates.kept[slot_of(candidates, candidates.count - 1)]
        if point.t - last.t < _SPACING:
            last.lowest = min(last.lowest, point.sensor_z)
            last.highest = max(last.highest, point.sensor_z)
            return
    append_floor_point(candidates, point)


def _is_proven(floor: FloorMemory, step: float) -> bool:
    """Return whether the vehicle has moved as one does above a floor that is a step [m] farther
    away, and above another place.
    """
    accepted, candidates = floor.accepted, floor.candidates
    if floor.here.t - candidates.kept[candidates.first].t < _STEP_TIME or step > floor.relief:
        return False
    last = accepted.kept[slot_of(accepted, accepted.count - 1)]
    if (
        _length(floor.here.sensor_x - last.sensor_x, floor.here.sensor_y - last.sensor_y)
        < _STEP_WAY
    ):
        return False
    return vertical_travel(candidates) >= max(_STEP_TRAVEL, 2.0 * _tolerance(floor))
