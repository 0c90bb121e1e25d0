"""Thrusters that do not give what they are asked, found in the residual wrench: suspected, probed, named."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from uvms_ocp.control.actuator_health.diagnosis import Diagnosis, Window
from uvms_ocp.control.actuator_health.effect import Effect
from uvms_ocp.control.actuator_health.innovation import Innovation
from uvms_ocp.control.actuator_health.onset_bank import OnsetBank, Suspicion
from uvms_ocp.control.actuator_health.probe import Answer, Probe, wave_of
from uvms_ocp.control.actuator_health.thresholds import HealthTuning
from uvms_ocp.control.actuator_health.verdicts import FaultKind, Health, ThrusterVerdict

_IN_A_ROW = 2  # looks that must agree before a probe begins
_DOUBT = 0.3  # [-] difference between two estimates of a share that says nothing
_UNPROBED = 1e3  # [-] standard deviation of a share that no probe has looked at
_NOTHING = 0.25  # share below which a thruster is dead, not weak
_STUCK_SIGMAS, _STUCK_SHARE = (
    4.0,
    0.03,
)  # constant thrust that is told from none, in its standard deviation and of the limit


class ThrusterMonitor:
    """Verdicts on all thrusters. Holds what was seen: build one per run.

    The residual wrench is what the disturbance observer finds beyond model and commands. A thruster is suspect where
    its fault explains changes of it better than noise and better than any other (`OnsetBank`); whether it is faulty
    is decided by a probe that water cannot answer (`Probe`), or, where no other thrusters cancel a wave, by more of the
    same evidence.
    """

    def __init__(
        self,
        matrix: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        *,
        tuning: HealthTuning,
        bandwidth: float,
        dt: float,
    ) -> None:
        """matrix (6, n) [N/N, N m/N]; lower, upper (n,) [N] limits; bandwidth [rad/s] of the residual; dt [s] of a tick."""
        n = matrix.shape[1]
        self._matrix, self._lower, self._upper, self._tuning = matrix, lower, upper, tuning
        self._every = max(1, round(tuning.sample_time / dt))
        self._decay = math.exp(-bandwidth * dt)
        self._innovation = Innovation(np.abs(matrix) @ np.maximum(upper, -lower), tuning)
        self._bank = OnsetBank(matrix, bandwidth=bandwidth, correlation=tuning.correlation)
        self._window = Window(matrix, bandwidth=bandwidth)
        self._probe: Probe | None = None
        self._suspicion: Suspicion | None = None
        self._filtered = np.zeros(n)
        self._ticks, self._in_a_row = 0, 0
        self._quiet_until, self._rested_from = -math.inf, np.full(n, -math.inf)
        self._started = False
        self.effect = Effect.sound(n)
        """What thrusters make of their commands, by the verdicts."""
        self.verdicts = [ThrusterVerdict() for _ in range(n)]
        """On each thruster."""

    def probe(self, t: float) -> np.ndarray | None:
        """Thrust (n,) [N] to add at time t [s] to find out; `None` where nothing is suspect."""
        return None if self._probe is None else self._probe.thrust(t)

    def pause(self) -> None:
        """The residual is not to be trusted: forget, and begin anew once it is back."""
        self._end_probe()
        self._started = False

    def update(self, residual: np.ndarray, asked: np.ndarray, t: float) -> tuple[int, ...]:
        """Take in the residual (6,) [N, N m] and the thrust asked (n,) [N], as modelled, at time t [s].

        Returns the thrusters that were found faulty now.
        """
        thrust = np.where(self.effect.works, asked, 0.0)
        self._filtered = thrust + (self._filtered - thrust) * self._decay
        if not self._started:
            self._start(thrust, t)
        self._ticks += 1
        if self._ticks % self._every:
            return ()
        wrench = self._matrix @ self._filtered
        if t < self._quiet_until:
            self._innovation.restart(residual, wrench)
            return ()
        self._innovation.look(residual, wrench)
        self._bank.look(self._filtered, self._innovation, t, keep=self._probe is not None)
        self._window.look(self._filtered, self._innovation, t)
        return self._suspect(t) if self._probe is None else self._follow(self._probe, t)

    def _start(self, thrust: np.ndarray, t: float) -> None:
        self._filtered, self._started = thrust.copy(), True
        self._quiet_until = t + self._tuning.settling
        self._bank.clear()
        self._window.clear()

    def _suspect(self, t: float) -> tuple[int, ...]:
        found, tuning = self._bank.best(t >= self._rested_from), self._tuning
        doubtful = found.gain > tuning.suspect_gain and found.misfit < tuning.misfit
        self._in_a_row = self._in_a_row + 1 if doubtful else 0
        if self._in_a_row < _IN_A_ROW:
            return ()
        wave = wave_of(self._matrix * self.effect.works, found.thruster)
        if wave is None:
            return self._without_probe(found, t)
        self._suspicion = found
        amplitude = tuning.probe_share * float(np.min(np.minimum(self._upper, -self._lower)[self.effect.works]))
        self._probe = Probe(self._matrix, amplitude / self.effect.share_or_one * wave, t, tuning)
        self._mark(found.thruster, Health.SUSPECT)
        return ()

    def _without_probe(self, found: Suspicion, t: float) -> tuple[int, ...]:
        tuning = self._tuning
        if found.gain < tuning.unprobed_gain or found.lead < tuning.unprobed_gain / 4.0:
            return ()
        answer = Answer(thrusters=(found.thruster,), theta=np.array([found.theta]), gain=found.gain, lead=found.lead)
        return self._name(answer, [self._diagnosis(found.thruster, found.theta, _UNPROBED)])

    def _follow(self, probe: Probe, t: float) -> tuple[int, ...]:
        probe.look(self._filtered, self._innovation, t)
        tuning, suspicion = self._tuning, self._suspicion
        if probe.cycles < tuning.probe_cycles or suspicion is None:
            return ()
        answer = probe.answer()
        decisive = answer.gain >= tuning.fault_gain and answer.lead >= tuning.margin
        if not decisive and (found := self._unopposed(probe)) is not None:
            decisive, answer = True, found
        if decisive:
            diagnoses = [self._diagnosis(i, *probe.single(i)) for i in answer.thrusters]
            self._end_probe()
            return self._name(answer, diagnoses)
        if probe.cycles >= tuning.probe_longest or (answer.sigma < tuning.sure and answer.gain < tuning.margin):
            self._rested_from[probe.moved] = t + tuning.rest
            self._end_probe()
        return ()

    def _unopposed(self, probe: Probe) -> Answer | None:
        """The thruster that the onsets tell clearly, if the probe does not tell otherwise."""
        found, tuning = self._bank.best(self._moved_by(probe)), self._tuning
        theta, sigma = probe.single(found.thruster)
        opposed = abs(theta - found.theta) > _DOUBT + 3.0 * sigma
        if opposed or found.lead < tuning.fault_gain or found.misfit > tuning.misfit:
            return None
        return Answer(thrusters=(found.thruster,), theta=np.array([found.theta]), gain=found.gain, lead=found.lead)

    def _moved_by(self, probe: Probe) -> np.ndarray:
        moved = np.zeros(len(self._filtered), dtype=bool)
        moved[probe.moved] = True
        return moved

    def _diagnosis(self, thruster: int, theta: float, sigma: float) -> Diagnosis:
        share, memory = float(self.effect.share[thruster]), self._innovation.share
        return self._window.diagnosis(thruster, share=share, memory=memory, theta=theta, sigma=sigma)

    def _name(self, answer: Answer, diagnoses: Sequence[Diagnosis]) -> tuple[int, ...]:
        """Verdicts on what falls short by enough, and what it makes of commands from now on."""
        share, constant, found = self.effect.share.copy(), self.effect.constant.copy(), []
        for i, diagnosis in zip(answer.thrusters, diagnoses, strict=True):
            left = share[i] - diagnosis.missing
            if diagnosis.stuck_lead <= 0.0 and left > self._tuning.sound_share * share[i]:
                continue
            follows = diagnosis.stuck_lead <= 0.0 and abs(left) >= _NOTHING
            share[i] = left if follows else 0.0
            constant[i] = 0.0 if follows else self._constant(i, diagnosis)
            found.append(i)
            self.verdicts[i] = ThrusterVerdict(
                health=Health.FAULTY,
                kind=_kind(float(share[i]), float(constant[i])),
                share=float(share[i]),
                constant=float(constant[i]),
                confidence=answer.lead,
                since=diagnosis.onset,
            )
        if found:
            self.effect = Effect(share=share, constant=constant)
            self._started = False
        return tuple(found)

    def _constant(self, thruster: int, diagnosis: Diagnosis) -> float:
        """Thrust [N] at which it is stuck; 0 where that cannot be told from none."""
        value = float(np.clip(diagnosis.constant, self._lower[thruster], self._upper[thruster]))
        least = max(_STUCK_SIGMAS * diagnosis.sigma, _STUCK_SHARE * self._upper[thruster])
        return value if abs(value) > least and diagnosis.stuck_lead > 0.0 else 0.0

    def _end_probe(self) -> None:
        self._probe, self._in_a_row = None, 0
        for i, verdict in enumerate(self.verdicts):
            if verdict.health is Health.SUSPECT:
                self._mark(i, Health.GOOD)

    def _mark(self, thruster: int, health: Health) -> None:
        if self.verdicts[thruster].health is not Health.FAULTY:
            self.verdicts[thruster] = ThrusterVerdict(health=health)


def _kind(share: float, constant: float) -> FaultKind:
    if share:
        return FaultKind.REVERSED if share < 0.0 else FaultKind.WEAK
    return FaultKind.STUCK if constant else FaultKind.DEAD
