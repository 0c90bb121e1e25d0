"""Whether an echo of the altimeter fits the motion of the vehicle and what the floor did so far.

Every echo is compared with the floor that echoes showed nearby. A floor that is nearer is believed at once, as the safe case.
One that is farther away is believed when echoes have agreed with each other for a while in which the vehicle moved
vertically, as an altimeter that is stuck shows a floor that follows the vehicle, and horizontally, as floors do not sink. The
floor that was known before is kept beside a new one, and believed again after a few echoes.
"""

from __future__ import annotations

import ctypes

from uvms_ocp.control.navigation.health.laws.spots import (
    MOST_SPOTS,
    Spot,
    Spots,
    apart,
    append_spot,
    copy_spots,
    forget_first,
    forget_older,
    keep_alone,
    room,
    slot_of,
    step_to,
    travel,
)
from uvms_ocp.control.navigation.health.reasons import Reason, Why, give
from uvms_ocp.control.navigation.health.tuning import HealthTuning
from uvms_ocp.functions.kernels.layout import Layout

_SIGMAS = 8.0
_SPACING = 0.5  # [s] between the echoes that are kept
_RETURN = 3  # echoes in a row from a floor known before that bring it back


class FloorWatch(Layout):
    """What echoes showed so far, and which steps of a floor are possible."""

    base: float
    """[m] by which echoes of one place may differ."""
    slope: float
    """[-] of the steepest floor."""
    memory: float
    """[s] for which an echo tells of the floor where it was taken."""
    spacing: float
    """[s] between the echoes that are kept."""
    step_time: float
    """[s] for which echoes of a floor that is farther away agree."""
    step_travel: float
    """[m] of vertical motion in that time."""
    step_way: float
    """[m] of horizontal motion."""
    relief: float
    """[m] of the highest step."""
    here: Spot
    """The newest."""
    known: Spots
    before: Spots
    candidates: Spots
    """Of a floor that is farther away; each with the vertical motion until the next one."""
    returned: int


def expect_floor(memory: ctypes.Structure, sigma: float, tuning: HealthTuning) -> None:
    """Prepare a `FloorWatch`; sigma [m]: noise of the altimeter."""
    memory.base, memory.slope, memory.memory = tuning.position + _SIGMAS * sigma, tuning.slope, tuning.floor_memory
    memory.spacing = max(_SPACING, tuning.floor_memory / (MOST_SPOTS - 2))
    for name in ("step_time", "step_travel", "step_way", "relief"):
        setattr(memory, name, getattr(tuning, name))


def believe(w: FloorWatch, why: Why) -> bool:
    """Whether to believe the echo from `here`, in order of time; what speaks against it otherwise, or all the same."""
    _forget(w)
    step = step_to(w.known, w.here, w.base, w.slope)
    if step == 0.0:
        _accept(w)
        return True
    if step > 0.0:
        _take_nearer(w)
        give(why, Reason.NEARER, step, 0.0)
        return True
    if w.before.count > 0 and step_to(w.before, w.here, w.base, w.slope) == 0.0:
        return _as_before(w, step, why)
    w.returned = 0
    return _farther(w, step, why)


def _accept(w: FloorWatch) -> None:
    known = w.known
    if known.count == 0 or w.here.t - known.kept[slot_of(known, known.count - 1)].t >= w.spacing:
        append_spot(known, w.here)
    w.candidates.count = 0
    w.returned = 0


def _take_nearer(w: FloorWatch) -> None:
    if w.before.count == 0:
        copy_spots(w.before, w.known)
    keep_alone(w.known, w.here)
    w.candidates.count = 0
    w.returned = 0


def _as_before(w: FloorWatch, step: float, why: Why) -> bool:
    w.returned += 1
    if w.returned < _RETURN:
        give(why, Reason.AS_BEFORE, -step, 0.0)
        return False
    copy_spots(w.known, w.before)
    w.before.count = 0
    _accept(w)
    return True


def _farther(w: FloorWatch, step: float, why: Why) -> bool:
    if w.candidates.count > 0 and not abs(w.here.z - _first_candidate_z(w)) <= _grace(w):
        w.candidates.count = 0
    _add_candidate(w)
    if _is_proven(w, -step):
        keep_alone(w.known, w.here)
        w.before.count = 0
        _accept(w)
        return True
    give(why, Reason.FARTHER, -step, 0.0)
    return False


def _first_candidate_z(w: FloorWatch) -> float:
    return w.candidates.kept[w.candidates.first].z


def _grace(w: FloorWatch) -> float:
    """[m] by which an echo may differ from the first one that was not believed, of one floor."""
    return 0.5 * (w.base + room(w.here, w.candidates.kept[w.candidates.first], w.slope))


def _add_candidate(w: FloorWatch) -> None:
    found, here = w.candidates, w.here
    if found.count > 0:
        last = found.kept[slot_of(found, found.count - 1)]
        if here.t - last.t < w.spacing:
            last.lowest = min(last.lowest, here.sensor_z)
            last.highest = max(last.highest, here.sensor_z)
            return
    append_spot(found, here)


def _is_proven(w: FloorWatch, step: float) -> bool:
    """Whether the vehicle has moved as one does above a floor that is a step [m] farther away, and above another place."""
    known, found = w.known, w.candidates
    if w.here.t - found.kept[found.first].t < w.step_time or step > w.relief:
        return False
    if apart(w.here, known.kept[slot_of(known, known.count - 1)]) < w.step_way:
        return False
    return travel(found) >= max(w.step_travel, 2.0 * _grace(w))


def _forget(w: FloorWatch) -> None:
    oldest, found = w.here.t - w.memory, w.candidates
    forget_older(w.known, oldest)
    forget_older(w.before, oldest)
    if found.count > 1 and found.kept[found.first].t < oldest:
        forget_first(found)
