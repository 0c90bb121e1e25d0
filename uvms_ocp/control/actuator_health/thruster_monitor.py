"""Thrusters that do not give what they are asked, found in the residual wrench and named."""

from __future__ import annotations

import math

import numpy as np

from uvms_ocp.control.actuator_health.blame import NOBODY, Blame, BlameWindow
from uvms_ocp.control.actuator_health.effect import Effect
from uvms_ocp.control.actuator_health.manner import Manner, manner_of
from uvms_ocp.control.actuator_health.thresholds import ActuatorHealthTuning
from uvms_ocp.control.actuator_health.verdicts import FaultKind, Health, ThrusterVerdict

_NOTHING = 0.3  # share below which a thruster is dead, not weak
_STUCK_SIGMAS = 4.0  # standard deviations from which on a constant thrust is told from none
_STUCK_SHARE = 0.1  # of the limit, likewise
_BEYOND = 1.1  # of the limits: no thruster sticks farther out


class ThrusterMonitor:
    """Verdicts on all thrusters. Holds what was seen: build one per run.

    The residual wrench is what the disturbance observer finds beyond model and commands. A thruster is faulty once its
    asked thrust has explained nearly all changes of it, and no other thruster as well, look after look.
    """

    def __init__(
        self,
        matrix: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        *,
        tuning: ActuatorHealthTuning,
        bandwidth: float,
        period: float,
    ) -> None:
        """matrix (6, n) [N/N, N m/N]; lower, upper (n,) [N] limits; bandwidth [rad/s] of the residual; period [s] of looks."""
        n = matrix.shape[1]
        self._lower, self._upper, self._tuning, self._bandwidth = lower, upper, tuning, bandwidth
        reach = np.abs(matrix) @ np.maximum(upper, -lower)
        scale = np.repeat([tuning.force_scale, tuning.moment_scale], 3) * reach
        self._window = BlameWindow(matrix, np.maximum(scale, 1e-6 * reach.max(initial=1.0)), tuning, period=period)
        self._quiet_until, self._started = -math.inf, False
        self._last, self._evidence = NOBODY, 0.0
        self.suspect = -1
        """Counted from 0 [-]; -1 for none."""
        self.effect = Effect.sound(n)
        """What thrusters make of their commands, by the verdicts."""
        self.verdicts = [ThrusterVerdict() for _ in range(n)]
        """On each thruster."""

    def pause(self) -> None:
        """The residual is not to be trusted: forget, and begin anew once it is back."""
        self._started = False

    def look(self, residual: np.ndarray, asked: np.ndarray, t: float) -> tuple[int, ...]:
        """Take in the residual (6,) [N, N m] at time t [s], and the thrust asked (n,) [N] that it tells of, of thrusters that
        all follow; the thrusters that were found faulty now."""
        if not self._started:
            self._restart(t)
        if t < self._quiet_until:
            return ()
        self._window.look(residual, self.effect.share * asked, t)
        blame = self._window.blame()
        again = blame.thruster >= 0 and blame.thruster == self._last.thruster
        self._evidence = self._evidence + min(blame.lead / self._tuning.clear_lead, 1.0) ** 2 if again else 0.0
        self._last = blame
        if blame.thruster != self.suspect:
            self._mark(blame.thruster)
        return self._name(blame, t) if self._evidence > self._tuning.looks else ()

    def _restart(self, t: float) -> None:
        self._started, self._quiet_until = True, t + self._tuning.settling
        self._last, self._evidence = NOBODY, 0.0
        self._window.clear()

    def _name(self, blame: Blame, t: float) -> tuple[int, ...]:
        """The verdict, unless so little is missing that it does no harm, and what comes of commands from now on."""
        i, share, constant = blame.thruster, self.effect.share.copy(), self.effect.constant.copy()
        manner = manner_of(*self._window.history(i), self._bandwidth, _NOTHING)
        if manner.share > self._tuning.sound_share:
            self._evidence = 0.0
            return ()
        share[i] *= manner.share
        constant[i] = 0.0 if share[i] else self._constant(i, manner)
        self.effect = Effect(share=share, constant=constant)
        self.verdicts[i] = ThrusterVerdict(
            health=Health.FAULTY,
            kind=_kind(float(share[i]), float(constant[i])),
            share=float(share[i]),
            constant=float(constant[i]),
            confidence=blame.lead,
            since=manner.onset,
        )
        self._restart(t)
        return (i,)

    def _constant(self, thruster: int, manner: Manner) -> float:
        """Thrust [N] at which it is stuck; 0 where that cannot be told from none."""
        lower, upper = float(self._lower[thruster]), float(self._upper[thruster])
        possible = _BEYOND * lower <= manner.constant <= _BEYOND * upper
        clear = abs(manner.constant) > max(_STUCK_SIGMAS * manner.sigma, _STUCK_SHARE * upper)
        return min(max(manner.constant, lower), upper) if possible and clear else 0.0

    def _mark(self, suspect: int) -> None:
        self.suspect = suspect
        for i, verdict in enumerate(self.verdicts):
            health = Health.SUSPECT if i == suspect else Health.GOOD
            if verdict.health not in (Health.FAULTY, health):
                self.verdicts[i] = ThrusterVerdict(health=health)


def _kind(share: float, constant: float) -> FaultKind:
    if share:
        return FaultKind.REVERSED if share < 0.0 else FaultKind.WEAK
    return FaultKind.STUCK if constant else FaultKind.DEAD
