"""What became of a reading."""

from __future__ import annotations

from dataclasses import dataclass

from uvms_ocp.arguments import checked


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class Outcome:
    """The newest reading of a channel that was compared with the estimate."""

    t: float
    """[s] when it was taken."""
    squared: float
    """[-] innovation, normalised and squared: chi-squared with `degrees` where sensor and vehicle are as expected."""
    degrees: int
    """[-] of freedom."""
    accepted: bool
    """Whether it was used; of the joints, every one of them."""
