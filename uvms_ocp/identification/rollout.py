"""Shooting segments of recordings, and their simulation, many at once, with sensitivities.

The derivatives of single steps come from the stage, and are chained here: ``S_next = A S + B + C
du/dp``. That is the variational equation of the discrete model, so that slopes are those of what is
simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np

from uvms_ocp.codegen.background import n_processors
from uvms_ocp.codegen.buffered import BufferedFunction
from uvms_ocp.codegen.compile import compile_function
from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification import recording as recordings
from uvms_ocp.identification.model import N_Q, N_V, PAST, PAST_STEP, StageFunctions, Vehicle
from uvms_ocp.robot import limits, spatial

# A stretch of a recording as a simulation needs it: what was commanded step by step, and what was
# seen when.

N_SEEN = 9
"""Rows of what is seen, as `StageFunctions.outputs` has them: velocity, angular velocity, vertical; three of
each.
"""
RATE_WINDOW = 0.6
"""[s] over which attitude is smoothed for an angular velocity that is not recorded."""
POSE_INTERVAL = 0.2
"""[s] between the poses from which a linear velocity is taken that is not recorded."""
COMMANDS = ("thrust", "wrench", "propeller_commands")

_MOST_STEPS = 4_000  # one after the other in a function, and states whose outputs are taken at once

N_START = 9
"""unknowns of a start: velocity (6), then the turn of the attitude in B (3)."""

Weights = Callable[[int, tuple[np.ndarray, ...]], Sequence[tuple[np.ndarray, np.ndarray]]]
"""Maps the index of a segment and its rows to weights w and weighted residuals w r of each sensor,
both (m, 3).
"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Segment:
    """Segment of one recording for multiple shooting, in steps of equal length."""

    recording: str
    """Name of the recording."""
    edges: np.ndarray
    """(n + 1,) [s] edges of its steps."""
    commands: recordings.ZeroOrderHold
    """Commands of the actuators."""
    joints: np.ndarray
    """(3 n_j, n) [rad, rad/s, rad/s2] motion of the joints in the middle of each step, as in
    `StageFunctions`.
    """
    t: tuple[np.ndarray, ...]
    """Three of (m,) [s]: times of the samples of each sensor."""
    measured: tuple[np.ndarray, ...]
    """Three of (m, 3) [m/s, rad/s, -] samples of each sensor."""
    q: np.ndarray
    """(7,) [m, -] measured pose at the beginning, its position 0."""
    v: np.ndarray
    """(6,) [m/s, rad/s] measured velocity in B at the beginning."""

    @property
    def step(self) -> float:
        """[s] length of a step."""
        return float(self.edges[1] - self.edges[0])

    def first(self, duration: float) -> Segment:
        """Return its first part of some duration [s], at least a step."""
        n = min(max(1, round(duration / self.step)), len(self.edges) - 1)
        return _cut(self, 0, n, self.q, self.v)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PreparedRecording:
    """A recording with the angular velocity, commands of actuators and joints that follow from its
    channels.
    """

    recording: recordings.Recording
    rate: recordings.Channel
    commands: recordings.ZeroOrderHold
    joints: recordings.Channel | None
    """Their positions, where the vehicle has any."""
    vertical: np.ndarray
    """(n, 3) [-] W's vertical in B, of each sample of the attitude."""

    @staticmethod
    def of(
        recording: recordings.Recording, vehicle: Vehicle, window: float = RATE_WINDOW
    ) -> PreparedRecording:
        """Prepare a recording; window: [s] over which attitude is smoothed where no angular
        velocity is recorded.

        Without a linear velocity means between positions take its place.

        Raises InvalidInput for a channel that is missing or of other joints or actuators, and for
        channels that have no time in common.
        """
        attitude = recording.channel("attitude")
        channels = recording.channels
        begin, end = recording.span
        if not begin < end:
            spans = f"one channel begins at {begin:.6g} s, and another has ended at {end:.6g} s"
            raise InvalidInput(
                f"{recording.name}: {spans}; give channels of one clock, with times in common"
            )
        if "linear_velocity" not in channels and "position" in channels:
            velocity = recordings.pose_velocity(channels["position"], attitude, POSE_INTERVAL)
            recording = replace(recording, channels={**channels, "linear_velocity": velocity})
        recording.channel("linear_velocity")
        rate = recording.channels.get("angular_velocity")
        if rate is None:
            t, omega = recordings.angular_rate(attitude, window)
            sample_times = attitude.undelayed_t
            inside = sample_times[(sample_times >= t[0]) & (sample_times <= t[-1])]
            rate = recordings.Channel(t=inside, values=recordings.interpolated(inside, t, omega))
        commands = recordings.ZeroOrderHold(_actuator_commands(recording, vehicle))
        joints = _moved(recording, vehicle)
        vertical = recordings.rotations(attitude, attitude.undelayed_t)[:, 2, :].copy()
        return PreparedRecording(
            recording=recording, rate=rate, commands=commands, joints=joints, vertical=vertical
        )

    def stretches(self, step: float, duration: float | None = None) -> tuple[Segment, ...]:
        """Cut the recording, in steps of `step` [s], into equal stretches of about `duration` [s];
        by default into one.

        Raises InvalidInput where they would not have a step.
        """
        begin, end = self.recording.span
        total = int((end - begin) / step)
        n = max(1, round(total * step / duration)) if duration else 1
        if total < n:
            duration_text = (
                f"{self.recording.name}: {end - begin:.4g} s in stretches of"
                f" {duration or np.inf:g} s"
            )
            raise InvalidInput(
                f"{duration_text}; a step takes {step:g} s: record more, or give longer stretches or"
                " shorter steps"
            )
        whole = self._whole(begin + step * np.arange(total + 1))
        n_steps = total // n
        return self._parts(whole, n_steps * np.arange(n), n_steps)

    def windows(self, step: float, start_window: float, horizon: float) -> tuple[Segment, ...]:
        """Cut stretches in steps of `step` [s], of the times `start_window` [s] and `horizon` [s]
        after it, that begin a horizon apart.

        Their horizons follow each other without gaps; the last one, if it is cut off, is left out.
        """
        (segment,) = self.stretches(step)
        n_before = round(start_window / step)
        n_after = round(horizon / step)
        n = len(segment.edges) - 1
        begins = np.arange(0, n - n_before - n_after + 1, n_after)
        return self._parts(segment, begins, n_before + n_after)

    def _whole(self, edges: np.ndarray) -> Segment:
        attitude = self.recording.channel("attitude")
        velocity = self.recording.channel("linear_velocity")
        return Segment(
            recording=self.recording.name,
            edges=edges,
            commands=self.commands,
            joints=_joints(self.joints, edges),
            t=(velocity.undelayed_t, self.rate.undelayed_t, attitude.undelayed_t),
            measured=(velocity.values, self.rate.values, self.vertical),
            q=np.zeros(7),
            v=np.zeros(6),
        )

    def _parts(self, segment: Segment, begins: np.ndarray, n: int) -> tuple[Segment, ...]:
        """Cut segments of n steps that begin at edges begins (m,)."""
        t = segment.edges[begins]
        attitude = self.recording.channel("attitude")
        turns = recordings.interpolated(t, attitude.undelayed_t, attitude.values)
        attitudes = turns / np.linalg.norm(turns, axis=1, keepdims=True)
        q = np.hstack([np.zeros((len(t), 3)), attitudes])
        linear = recordings.interpolated(t, segment.t[0], segment.measured[0])
        angular = recordings.interpolated(t, segment.t[1], segment.measured[1])
        v = np.hstack([linear, angular])
        parts = []
        for i, k in enumerate(begins.tolist()):
            parts.append(_cut(segment, k, k + n, q[i], v[i]))
        return tuple(parts)


def _cut(segment: Segment, first: int, last: int, q: np.ndarray, v: np.ndarray) -> Segment:
    """Return the part of a segment between two of its edges, which begins at pose q (7,) and
    velocity v (6,).
    """
    edges = segment.edges[first : last + 1]
    times = []
    measured = []
    for t, values in zip(segment.t, segment.measured, strict=True):
        begin = np.searchsorted(t, edges[0])
        end = np.searchsorted(t, edges[-1], side="right")
        times.append(t[begin:end])
        measured.append(values[begin:end])
    return replace(
        segment,
        edges=edges,
        joints=segment.joints[:, first:last],
        t=tuple(times),
        measured=tuple(measured),
        q=q,
        v=v,
    )


def _actuator_commands(recording: recordings.Recording, vehicle: Vehicle) -> recordings.Channel:
    """Return the command of each actuator."""
    name = vehicle.actuators.commands or _only_commands(recording)
    channel = recording.channel(name)
    allocation = vehicle.actuators.allocation
    if name == "thrust":
        channel = channel.of(vehicle.actuators.names, f"{recording.name}: thrust")
    if channel.values.shape[1] != allocation.shape[1]:
        columns_text = f"{recording.name}: {name} has {channel.values.shape[1]} columns"
        raise InvalidInput(f"{columns_text}; the actuators' allocation takes {allocation.shape[1]}")
    return recordings.Channel(
        t=channel.t, values=channel.values @ allocation.T, delay=channel.delay
    )


def _only_commands(recording: recordings.Recording) -> str:
    names = [name for name in COMMANDS if name in recording.channels]
    if len(names) != 1:
        raise InvalidInput(
            f"{recording.name}: commands {names} recorded; allowed: one of {', '.join(COMMANDS)}"
        )
    return names[0]


def _moved(recording: recordings.Recording, vehicle: Vehicle) -> recordings.Channel | None:
    """Return the positions of the vehicle's joints, in its order."""
    names = tuple(joint.name for joint in limits.joints_of(vehicle.dynamics.model, free_flyer=True))
    if not names and "joint_positions" not in recording.channels:
        return None
    channel = recording.channel("joint_positions").of(names, f"{recording.name}: joint_positions")
    if channel.values.shape[1] != vehicle.dynamics.model.nq - N_Q:
        columns_text = f"{recording.name}: joint_positions has {channel.values.shape[1]} columns"
        raise InvalidInput(
            f"{columns_text}; the vehicle has joints {', '.join(names) or 'of no arm'}"
        )
    return channel


def _joints(
    channel: recordings.Channel | None, edges: np.ndarray, window: float = 0.4
) -> np.ndarray:
    middle = (edges[1:] + edges[:-1]) / 2
    if channel is None:
        return np.zeros((0, len(middle)))
    rows = []
    for derivative in range(3):
        t, values = recordings.smoothed(channel.undelayed_t, channel.values, window, derivative)
        rows += [np.interp(middle, t, column) for column in values.T]
    return np.array(rows)


# Simulation of many stretches at once, with the sensitivities of what is seen.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SegmentStart:
    """State in which a segment begins."""

    q: np.ndarray
    """(7,) [m, -] pose."""
    v: np.ndarray
    """(6,) [m/s, rad/s] velocity in B."""

    def moved(self, change: np.ndarray) -> SegmentStart:
        """Return the start moved by a change (9,) [m/s, rad/s, rad]."""
        turn = spatial.quaternion_exp(change[N_V:])
        turned = np.asarray(spatial.quaternion_multiply(self.q[3:], turn))
        attitude = turned / np.linalg.norm(turned)
        return SegmentStart(q=np.concatenate([self.q[:3], attitude]), v=self.v + change[:N_V])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PredictedOutputs:
    """Predicted outputs of the three sensors over a segment, and the state at its end; with slopes,
    weighted squares of them.
    """

    rows: tuple[np.ndarray, ...]
    """Three of (m, 3) [m/s, rad/s, -] predicted outputs."""
    end: np.ndarray
    """(n_x,) [as the state] state at the end."""
    H: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """(n_p + 9, n_p + 9) [1 / unknowns^2] ``sum w s s'`` of the slopes s of all rows with the
    unknowns, then with the start.
    """
    g: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """(n_p + 9,) [1 / unknowns] ``sum w r s``"""
    loss: float = 0.0
    """Cost of the residuals of its rows, for passes that do not keep the rows."""
    end_slope: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """(n_x, n_p + 9) [as the state, per unknown]"""


class Rollout:
    """Simulator of segments by one stage; functions are compiled where there is a compiler, once
    for each number of steps.
    """

    def __init__(self, stage: StageFunctions) -> None:
        self.stage = stage
        self.step = compile_function(stage.step)
        self.slope = compile_function(stage.slope)
        self._many: dict[tuple[str, int, int], ca.Function] = {}

    def predict(
        self,
        stretches: Sequence[Segment],
        starts: Sequence[SegmentStart],
        p: np.ndarray,
        weights: Weights | None = None,
    ) -> list[PredictedOutputs]:
        """Simulate stretches of equally many steps, all with unknowns p (n, n_p) [any], a row for
        each; with slopes if weighted.

        Raises InvalidInput where they have different numbers of steps, or joints other than the
        vehicle's.
        """
        n = {len(segment.edges) - 1 for segment in stretches}
        n_joint_rows = {segment.joints.shape[0] for segment in stretches}
        if len(n) != 1 or n_joint_rows != {3 * self.stage.n_j}:
            raise InvalidInput(
                f"stretches of {sorted(n)} steps; allowed: equally many, with all joints of the"
                " vehicle"
            )
        run = _StretchRun(self, stretches, starts, p, n.pop())
        if weights is None:
            return run.rows()
        return run.with_slopes(weights)

    def many(self, name: str, function: ca.Function, n: int, m: int) -> ca.Function:
        """Return a function n times after itself, m of these beside each other, on all processors;
        or, with n = 0, only the latter.
        """
        key = (name, n, m)
        if key not in self._many:
            chain = function.mapaccum(n) if n else function
            self._many[key] = chain.map(m, "thread", min(m, n_processors()))
        return self._many[key]


class _StretchRun:
    """One simulation of m stretches in n steps: states (m, n + 1, n_x)."""

    def __init__(
        self,
        rollout: Rollout,
        stretches: Sequence[Segment],
        starts: Sequence[SegmentStart],
        p: np.ndarray,
        n: int,
    ) -> None:
        self._rollout = rollout
        self._stage = rollout.stage
        self._stretches = stretches
        self._n = n
        self._p = p
        self._delays = self._each("delays", self._stage.delays, p.T)
        u = np.vstack(
            [
                segment.commands.mean(segment.edges - d[0, 0])
                for segment, (d, _) in zip(stretches, self._delays, strict=True)
            ]
        )
        past = np.hstack(
            [segment.commands.mean(self._past(k)).T for k, segment in enumerate(stretches)]
        )
        self._begun = self._each("begun", self._stage.begun, past, p.T)
        self._given = (
            u.T,
            np.hstack([segment.joints for segment in stretches]),
            np.repeat(p, n, axis=0).T,
            np.repeat([segment.step for segment in stretches], n)[None],
        )
        self._x = np.empty((len(p), n + 1, self._stage.n_x))
        self._x[:, 0] = [
            np.concatenate([s.q, s.v, w.ravel()])
            for s, (w, _, _) in zip(starts, self._begun, strict=True)
        ]
        for k in range(0, n, _MOST_STEPS):
            part = [
                segment.reshape(len(segment), len(p), n)[:, :, k : k + _MOST_STEPS]
                for segment in self._given
            ]
            steps = part[0].shape[2]
            arguments = (segment.reshape(len(segment), len(p) * steps) for segment in part)
            (after,) = _evaluated(
                rollout.many("step", rollout.step, steps, len(p)), self._x[:, k].T, *arguments
            )
            self._x[:, k + 1 : k + 1 + steps] = after.T.reshape(len(p), steps, -1)

    def rows(self) -> list[PredictedOutputs]:
        m, n, _ = self._x.shape
        parts = np.array_split(np.arange(m * n), -(-m * n // _MOST_STEPS))
        y = np.vstack([self._outputs(part)[0].T for part in parts]).reshape(m, n, N_SEEN)
        return [
            PredictedOutputs(rows=self._sampled(k, y[k]), end=self._x[k, -1])
            for k in range(len(self._stretches))
        ]

    def with_slopes(self, weights: Weights) -> list[PredictedOutputs]:
        m, n, _ = self._x.shape
        y, *slopes = self._outputs(np.arange(m * n))
        y = y.T.reshape(m, n, N_SEEN)
        y_x, y_p = (_blocks(derivative, -1, m, n) for derivative in slopes)
        S = self._sensitivities()
        outputs = []
        for k in range(len(self._stretches)):
            slopes = y_x[k] @ S[k]
            slopes[:, :, : self._stage.n_p] += y_p[k]
            rows = self._sampled(k, y[k])
            H, g = self._squares(k, y[k], slopes, weights(k, rows))
            outputs.append(
                PredictedOutputs(rows=rows, H=H, g=g, end=self._x[k, -1], end_slope=S[k, -1].copy())
            )
        return outputs

    def _squares(
        self,
        k: int,
        y: np.ndarray,
        slopes: np.ndarray,
        weights: Sequence[tuple[np.ndarray, np.ndarray]],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Sum weighted squares over the samples by sums of weights over steps: a step may hold many
        samples, and slopes are linear within it.
        """
        n = self._n
        n_p = slopes.shape[2]
        step = self._stretches[k].step
        H = np.zeros((n_p, n_p))
        g = np.zeros(n_p)
        late = np.concatenate([-self._delays[k][1][1], np.zeros(N_START)])
        for sensor, (w, wr) in enumerate(weights):
            (index, share) = self._place(k, sensor)
            s = slopes[:, 3 * sensor : 3 * sensor + 3]
            # A delay shifts all samples along the rate of their step, but those before the first,
            # where there is only its start.
            steps, place = np.unique(np.where(index + share > 0.0, index, n), return_inverse=True)
            first = np.where(steps < n, steps, 0)
            last = np.where(steps < n, steps + 1, 0)
            shift: np.ndarray | float = 0.0
            if sensor == 0:
                shift = (y[last, :3] - y[first, :3])[..., None] / step * late
            ends = [(s[at] + shift).reshape(-1, n_p) for at in (first, last)]
            place = (3 * place.reshape(-1, 1) + np.arange(3)).ravel()
            size = 3 * len(steps)
            sides = list(zip((1.0 - share[:, None], share[:, None]), ends, strict=True))
            for part, end in sides:
                sums = [
                    np.bincount(place, (w * part * other_part).ravel(), size)[:, None] * far
                    for other_part, far in sides
                ]
                H += end.T @ (sums[0] + sums[1])
                g += end.T @ np.bincount(place, (wr * part).ravel(), size)
        return H, g

    def _outputs(self, chosen: np.ndarray) -> list[np.ndarray]:
        """Evaluate the outputs and their derivatives, side by side, at the chosen (l,) of all
        states.
        """
        function = self._rollout.many("seen", self._stage.outputs, 0, len(chosen))
        n = self._x.shape[1]
        return _evaluated(
            function, self._x.reshape(-1, self._stage.n_x)[chosen].T, self._p[chosen // n].T
        )

    def _each(
        self, name: str, function: ca.Function, *arguments: np.ndarray
    ) -> list[list[np.ndarray]]:
        """Evaluate a function for every stretch, whose arguments are side by side."""
        m = len(self._p)
        results = _evaluated(self._rollout.many(name, function, 0, m), *arguments)
        blocks = [np.split(result, m, axis=1) for result in results]
        return [list(of_stretch) for of_stretch in zip(*blocks, strict=True)]

    def _sensitivities(self) -> np.ndarray:
        """Compute the slopes (m, n + 1, n_x, n_p + 9) of states with unknowns and starts."""
        m = len(self._stretches)
        n = self._n
        stage = self._stage
        before = self._x[:, :-1].reshape(-1, stage.n_x).T
        derivatives = _evaluated(
            self._rollout.many("slope", self._rollout.slope, 0, m * n), before, *self._given
        )
        widths = stage.n_x, stage.n_p, stage.n_u
        A, B, C = (
            _blocks(segment, width, m, n)
            for segment, width in zip(derivatives, widths, strict=True)
        )
        for k, segment in enumerate(self._stretches):
            d, dd = self._delays[k]
            slope = -segment.commands.mean_slope(segment.edges - d[0, 0])
            B[k] += np.einsum("nij,nj->ni", C[k], slope)[:, :, None] * dd[0]
        first = np.array([self._start_slope(k) for k in range(m)])
        return np.moveaxis(chained(np.moveaxis(A, 1, 0), np.moveaxis(B, 1, 0), first), 0, 1)

    def _past(self, k: int) -> np.ndarray:
        """Edges of the commands before the start."""
        return (
            self._stretches[k].edges[0] - self._delays[k][0][0, 0] + PAST_STEP * np.arange(-PAST, 1)
        )

    def _start_slope(self, k: int) -> np.ndarray:
        S = np.zeros((self._stage.n_x, self._stage.n_p + N_START))
        _, with_p, with_past = self._begun[k]
        later = (
            with_past @ -self._stretches[k].commands.mean_slope(self._past(k)).ravel()
        )  # command by command
        S[N_Q + N_V :, : self._stage.n_p] = with_p + np.outer(later, self._delays[k][1][0])
        S[N_Q : N_Q + N_V, self._stage.n_p : self._stage.n_p + N_V] = np.eye(N_V)
        S[3:N_Q, self._stage.n_p + N_V :] = turn_slope(self._x[k, 0, 3:N_Q])
        return S

    def _sampled(self, k: int, values: np.ndarray) -> tuple[np.ndarray, ...]:
        """Interpolate the rows of each sensor at the times of its samples."""
        sampled = []
        for sensor in range(3):
            index, share = self._place(k, sensor)
            rows = values[:, 3 * sensor : 3 * sensor + 3]
            later = share[:, None]
            sampled.append((1.0 - later) * rows[index] + later * rows[index + 1])
        return tuple(sampled)

    def _place(self, k: int, sensor: int) -> tuple[np.ndarray, np.ndarray]:
        segment = self._stretches[k]
        late = float(self._delays[k][0][1, 0]) if sensor == 0 else 0.0  # [s]
        place = np.maximum((segment.t[sensor] - late - segment.edges[0]) / segment.step, 0.0)
        index = np.clip(place.astype(int), 0, self._n - 1)
        return index, place - index


def chained(A: np.ndarray, B: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Solve (n + 1, ..., n_x, k) [any] ``S_next = A S + B``, B for the first n_p columns only,
    those of unknowns.

    A: (n, ..., n_x, n_x) [any], B: (n, ..., n_x, n_p) [any], first: (..., n_x, k) [any].
    """
    S = np.empty((len(A) + 1, *first.shape))
    S[0] = first
    n_p = B.shape[-1]
    for k, (a, b) in enumerate(zip(A, B, strict=True)):
        S[k + 1] = a @ S[k]
        S[k + 1, ..., :n_p] += b
    return S


def turn_slope(quaternion: np.ndarray) -> np.ndarray:
    """Compute the derivative of a quaternion (4,) xyzw by a turn in B, (4, 3) [1/rad]."""
    x, y, z, w = quaternion
    return np.array([[w, -z, y], [z, w, -x], [-y, x, w], [-x, -y, -z]]) / 2


def _evaluated(function: ca.Function, *arguments: np.ndarray) -> list[np.ndarray]:
    """Evaluate a function; results are column by column in memory of their own, as lists of numbers
    would take longer than the function.
    """
    evaluated = BufferedFunction(function)
    evaluated.write(*arguments)
    evaluated.evaluate()
    return [
        result.reshape(function.size_out(k), order="F")
        for k, result in enumerate(evaluated.results)
    ]  # columns are (m,) there


def _blocks(wide: np.ndarray, width: int, m: int, n: int) -> np.ndarray:
    """View (m, n, rows, width) of m n blocks side by side, in the same memory where that is column
    by column.
    """
    return np.moveaxis(wide.T.reshape(m, n, width, len(wide)), 2, 3)
