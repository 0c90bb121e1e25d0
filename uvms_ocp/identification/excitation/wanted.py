"""How well numbers are to be known: twice as well as steps and chirps by hand tell them, and well enough to count."""

from __future__ import annotations

import numpy as np

from uvms_ocp.identification.answers.numbers import KNOWN
from uvms_ocp.identification.excitation.assignment import Assignment
from uvms_ocp.identification.excitation.by_hand import BY_HAND, largest
from uvms_ocp.identification.methods.rollout import Rollout

HALF = 0.5
"""[-] of the smallest standard error by hand, which is wanted."""


def wanted(given: Assignment, rollout: Rollout) -> np.ndarray:
    """(m,) [units of numbers] standard errors of those that matter.

    Recordings can only add to what is believed: it is their own information that is to be more. Where those by hand say less
    than that, belief is left to stand.
    """
    chosen, aim = given.chosen, given.aim()
    by_hand = [largest(given, rollout, name).numbers for name in BY_HAND]
    least = np.array([[one.sigma for one in numbers] for numbers in by_hand]).min(axis=0)[chosen]
    learnt = np.array([[one.learnt for one in numbers] for numbers in by_hand]).max(axis=0)[chosen]
    sizes = np.array([one.size or np.inf for one in by_hand[0]])[chosen]
    believed = 1.0 / aim.deviations(np.zeros_like(aim.known)) ** 2
    told = np.where(learnt, 1.0 / least**2 - believed, 0.0)
    return np.asarray((believed + np.maximum(told / HALF**2, 1.0 / (KNOWN * sizes) ** 2)) ** -0.5)
