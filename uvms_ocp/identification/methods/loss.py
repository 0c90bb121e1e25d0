"""What a residual costs: half its square near zero, and linearly more far away, where outliers are (pseudo-Huber's loss)."""

from __future__ import annotations

import numpy as np


def loss(r: np.ndarray, outliers: float) -> float:
    """[-] of all residuals r (...) [-], which count linearly beyond outliers [-]."""
    return float((outliers**2 * (np.sqrt(1.0 + (r / outliers) ** 2) - 1.0)).sum())


def weighted(r: np.ndarray, J: np.ndarray, outliers: float) -> tuple[np.ndarray, np.ndarray]:
    """Residuals r (n,) [-] and slopes J (n, k) [any] whose squares have the gradient of the loss, linear beyond outliers [-]."""
    root = (1.0 + (r / outliers) ** 2) ** -0.25
    return (root * r).ravel(), (root[..., None] * J).reshape(-1, J.shape[-1])
