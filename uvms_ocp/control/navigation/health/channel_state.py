"""What is thought of one channel, from complaints, silence and the time without either."""

from __future__ import annotations

import math
from typing import Any

from uvms_ocp.arguments import trusted
from uvms_ocp.control.navigation.health.tuning import HealthTuning
from uvms_ocp.model.health import ChannelHealth, Trust
from uvms_ocp.model.sensing import SensorSpec
from uvms_ocp.model.state import Reading

_health = trusted(ChannelHealth)

_SILENCES = ("silent", "no echo")  # of a sensor, of one that has nothing to tell


class ChannelState:
    """The last reading that was used, and a verdict with its reason.

    A complaint makes a channel suspect for `HealthTuning.clean` seconds; silence makes it suspect and then lost, and so do
    readings that are all refused. A reading that is used ends the loss; nothing is lost for good.
    """

    def __init__(self, name: str, spec: SensorSpec, tuning: HealthTuning) -> None:
        self.spec, self._tuning, self._losses = spec, tuning, _losses(spec.dropout, tuning.chance)
        self.used: Reading[Any] | None = None
        """What the filter sees: the last reading that was not refused, or one that says that there is nothing to read."""
        self.taken: float | None = None
        """[s] when the last reading was taken that the estimate rests on."""
        self._used_at: float | None = None
        """[s] when it arrived; before the first, when the run began."""
        self.refused_at = -math.inf
        """[s] when a reading was last refused, by whomever."""
        self.impossible_at = -math.inf
        """[s] when one was last refused before the filter saw it: one that could not be, whatever else is wrong."""
        self._barred_until = -math.inf
        self.agreed = 0
        """Readings in a row that agreed with the estimate."""
        self.verdict = _health(channel=name, trust=Trust.GOOD)
        self._seen: Reading[Any] | None = None
        self._complaint, self._refusal, self._bad_at = "", "", -math.inf
        self._empty, self._gated = False, False

    @property
    def is_good(self) -> bool:
        """By the last verdict."""
        return self.verdict.trust is Trust.GOOD

    def is_new(self, reading: Reading[Any]) -> bool:
        """Whether it is another reading than the last time."""
        last, self._seen = self._seen, reading
        return last is not reading and (last is None or last.t != reading.t)

    def use(self, reading: Reading[Any], t: float) -> None:
        """The filter may see the reading at time t [s]; where it has a gate of its own, its outcome is waited for."""
        self.used, self._empty = reading, False
        if not self._gated:
            self._taken(t)

    def gate(self, why: str | None, t: float) -> None:
        """The filter refused the reading at time t [s], and why, or `None` where it has fused it.

        Its gate is narrow enough to refuse a sound reading now and then: refusals count as silence, and give it their reason.
        """
        self._gated = True
        if why is None:
            self._taken(t)
        else:
            self.refused_at, self._refusal = t, why

    def pass_empty(self, reading: Reading[Any]) -> None:
        """The sensor works but has nothing to tell, such as an echo that does not come back."""
        self.used, self._empty = reading, True

    def refuse(self, why: str, t: float) -> None:
        """A reading is not used at time t [s], and why."""
        self.refused_at = self.impossible_at = t
        self.doubt(why, t)

    def doubt(self, why: str, t: float) -> None:
        """Something speaks against the channel at time t [s]; its readings are used all the same."""
        if self.verdict.trust is Trust.GOOD or not self._complaint:
            self._complaint = why
        self._bad_at = t

    def bar(self, why: str, t: float) -> bool:
        """Something speaks against all readings of the channel at time t [s]: none is used before that is over.

        Returns whether that is news.
        """
        news = not self.is_barred(t)
        self.doubt(why, t)
        self._barred_until = t + self._tuning.clean
        return news

    def is_barred(self, t: float) -> bool:
        """Whether no reading is used at time t [s]."""
        return t <= self._barred_until

    def judge(self, t: float, period: float, *, contested: bool = False) -> bool:
        """Look at the clock at time t [s]; period [s] between two readings. Returns whether the verdict changed.

        contested: another channel is suspect that may be why the filter refuses this one, which then is not lost for it.
        """
        if self._used_at is None:
            self._used_at = t
        quiet = t - self._used_at
        trust = self._by_silence(quiet, period)
        if contested and self._gated and self.refused_at >= t - self._tuning.least_to_lose - period:
            trust = min(trust, Trust.SUSPECT)
        if trust is not Trust.GOOD:
            self._silent(quiet, t, anew=trust is not self.verdict.trust)
        elif t - self._bad_at <= self._tuning.clean:
            trust = Trust.SUSPECT
        else:
            self._complaint = ""
        if trust is self.verdict.trust:
            return False
        self.verdict = _health(channel=self.verdict.channel, trust=trust, why=self._complaint, since=t)
        return True

    def _taken(self, t: float) -> None:
        if self.used is not None:
            self.taken, self._used_at = self.used.t, t

    def _by_silence(self, quiet: float, period: float) -> Trust:
        patience = self.spec.delay + period * self._losses
        lost = patience + max(self._tuning.least_to_lose, self._tuning.periods_to_lose * period)
        suspect = patience + max(self._tuning.least_to_suspect, self._tuning.periods_to_suspect * period)
        if quiet > lost and not self._empty:
            return Trust.LOST
        return Trust.SUSPECT if quiet > suspect else Trust.GOOD

    def _silent(self, quiet: float, t: float, *, anew: bool) -> None:
        """anew: the verdict changes, and its reason gets new figures."""
        if not self._complaint or self._bad_at < t - quiet or (anew and self._complaint.startswith(_SILENCES)):
            silence = f"{_SILENCES[self._empty]} for {quiet:.2f} s"
            refused = self._gated and self.refused_at >= t - quiet
            self._complaint = self._refusal if refused else silence
        self._bad_at = t


def _losses(dropout: float, chance: float) -> float:
    """How many readings in a row [-] a sensor that drops some loses by chance."""
    if dropout <= 0.0:
        return 0.0
    return math.inf if dropout >= 1.0 else math.log(chance) / math.log(dropout)
