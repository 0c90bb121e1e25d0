"""Normal equations of one recording, its local unknowns apart: those of its own, and the starts of its stretches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification.methods.rollout import N_START


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Of n shared unknowns and n_local others [as `Unknowns.start`]."""

    cost: float
    """[-] half the weighted squares."""
    H: np.ndarray
    """(n, n) [1 / unknowns^2]"""
    g: np.ndarray
    """(n,) [1 / unknowns]"""
    H_local: np.ndarray
    """(n_local, n_local) [1 / unknowns^2]"""
    g_local: np.ndarray
    """(n_local,) [1 / unknowns]"""
    cross: np.ndarray
    """(n, n_local) [1 / unknowns^2]"""


def finite(blocks: Sequence[Block]) -> bool:
    """Whether all is: where a simulation runs away, its slopes do before its cost."""
    return all(np.isfinite(part).all() for one in blocks for part in (one.cost, one.H, one.H_local))


def places_of(n_p: int, stretch: int) -> np.ndarray:
    """(n_p + 9,) of the unknowns of a stretch: those of its recording, n_p, and of its start."""
    return np.concatenate([np.arange(n_p), n_p + N_START * stretch + np.arange(N_START)])
