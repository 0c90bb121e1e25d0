"""When a plan that is asked for now will be there, judged by the solves before."""

from __future__ import annotations

_FORGOTTEN = 0.95
"""[-] what is left of the longest one after every shorter one: twenty solves count."""
_SENT = 1e-3
"""[s] for question and answer on their way."""


class SolveDelay:
    """The longest solve of late. A plan that is late all the same keeps its time stamps; one that is early has to wait."""

    def __init__(self, first: float) -> None:
        """first [s]: before any solve was made."""
        self._longest = first

    @property
    def seconds(self) -> float:
        """From the request to the plan."""
        return self._longest + _SENT

    def count(self, solve_time: float) -> None:
        """One more solve took `solve_time` [s]."""
        self._longest = max(solve_time, _FORGOTTEN * self._longest)
