"""What commands are expected to tell where the vehicle is as it is believed to be, and where they lead it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification.answers.numbers import Number, numbers_at
from uvms_ocp.identification.excitation.assignment import Assignment
from uvms_ocp.identification.excitation.course import Courses
from uvms_ocp.identification.excitation.history import edges_of
from uvms_ocp.identification.methods.rollout import Rollout
from uvms_ocp.identification.recordings.recording import Channel
from uvms_ocp.identification.recordings.sampling import Held
from uvms_ocp.status import AdvisedStatus

FINER = 5
"""[-] steps of the simulation that says where commands lead, in one of the search."""


class DesignStatus(AdvisedStatus):
    """Where a design leads."""

    INSIDE = "inside the pool", "See how far vehicles with other numbers go before it drives one."
    OUTSIDE = (
        "leaves the pool or tilts too far",
        "Give a larger pool, less thrust or less time, or allow more iterations.",
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Excitation:
    """Commands, and what they are expected to tell."""

    commands: Channel
    """(n, n_u) [N, N m] held for a step each; they begin with 0."""
    states: np.ndarray
    """(k, n_x) [as `Stage`] that they lead to, from rest, in the finer steps of the last simulation."""
    swept: np.ndarray
    """(2, 3) [m] lowest and highest corner of what the hull sweeps, in W, from where the vehicle's origin begins."""
    numbers: tuple[Number, ...]
    """As they are known after one recording, where the vehicle is as it is believed to be."""
    information: np.ndarray
    """(n_p, n_p) [1 / unknowns^2] of one recording, priors left out."""
    status: DesignStatus


def excitation_of(given: Assignment, rollout: Rollout, commands: Channel) -> Excitation:
    """What other commands, held for equal steps, would tell."""
    step = float(commands.t[1] - commands.t[0])
    courses, held = Courses(rollout, given.unknowns, step, given.still), Held(commands)
    edges = commands.t[0] + edges_of(len(commands.t), step, courses.delay)
    aim = given.aim()
    information = aim.information(courses.of(held.mean(edges), -held.mean_slope(edges)), step)
    n, states = len(given.vehicle.shared.start), led(given, rollout, commands, given.unknowns)
    left = given.limits.beyond(states, margin=0.0)[0].any()
    return Excitation(
        commands=commands,
        states=states,
        swept=given.limits.swept(states),
        numbers=numbers_at(given.vehicle, given.vehicle.shared.start, aim.covariance(information)[:n, :n]),
        information=information,
        status=DesignStatus.OUTSIDE if left else DesignStatus.INSIDE,
    )


def led(given: Assignment, rollout: Rollout, commands: Channel, p: np.ndarray) -> np.ndarray:
    """States (k, n_x) [as `Stage`] to which commands lead a vehicle with unknowns p (n_p,) [as `Unknowns.start`]."""
    step = float(commands.t[1] - commands.t[0]) / FINER
    courses = Courses(rollout, p, step, given.still)
    edges = commands.t[0] + edges_of(FINER * len(commands.t), step, courses.delay)
    return courses.states(Held(commands).mean(edges))
