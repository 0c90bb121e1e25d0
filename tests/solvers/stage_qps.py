"""Random QPs of stages that have a point, and what others make of them."""

from __future__ import annotations

import casadi as ca
import numpy as np

from uvms_ocp.solvers.stage_qp import StageQp, StageQpSolution, StageShape


def random_shape(rng: np.random.Generator, N: int) -> StageShape:
    """Sizes differ from stage to stage; some stages have no control, no residual, no row."""
    sizes = {"n_x": (1, 6, N + 1), "n_u": (0, 5, N), "n_r": (0, 8, N + 1), "n_c": (0, 4, N + 1)}
    return StageShape(
        **{name: tuple(rng.integers(a, b, n).tolist()) for name, (a, b, n) in sizes.items()}
    )


def random_qp(seed: int, *, equalities: bool = False, inequalities: bool = True) -> StageQp:
    """Bounds around a random trajectory, some through it; x_0 free in some."""
    rng = np.random.default_rng(seed)
    qp = StageQp(random_shape(rng, int(rng.integers(1, 7))))
    for name in ("dynamics", "b", "J", "r", "g", "C"):
        qp.flat[name][:] = 0.6 * rng.standard_normal(len(qp.flat[name]))
    qp.flat["J"][rng.random(len(qp.flat["J"])) < 0.4] = 0.0
    qp.flat["damping"][:] = 10.0 ** rng.uniform(-3, 0, len(qp.flat["damping"]))
    if rng.random() < 0.7:
        qp.fix_initial_state(rng.standard_normal(qp.shape.n_x[0]))
    for k, z in enumerate(random_trajectory(rng, qp)):
        for lower, upper, value in (
            (qp.lower[k], qp.upper[k], qp.C[k] @ z),
            (qp.z_lower[k], qp.z_upper[k], z),
        ):
            draw = np.where(lower == upper, 0.7, rng.random(len(value)))
            room = np.where(
                rng.random((2, len(value))) < 0.8, rng.exponential(0.5, (2, len(value))), 0.0
            )
            if inequalities:
                lower[draw < 0.4] = (value - room[0])[draw < 0.4]
                middle = (draw > 0.2) & (draw < 0.6)
                upper[middle] = (value + room[1])[middle]
            if equalities:
                lower[draw > 0.9] = upper[draw > 0.9] = value[draw > 0.9]
    return qp


def reach_qp(seed: int, *, goal: bool, N: int = 30, n: int = 6) -> StageQp:
    """A double integrator of n axes that goes for a tool's goal of three rows, a constraint at the
    end or a cost all along.
    """
    rng = np.random.default_rng(seed)
    dt = 0.05
    n_x = 2 * n
    rows = {"n_r": (3 + n_x + n,) * N + (3 + n_x,), "n_c": (n,) * N + (3 if goal else 0,)}
    qp = StageQp(StageShape(n_x=(n_x,) * (N + 1), n_u=(n,) * N, **rows))
    tool = rng.standard_normal((3, n))
    M = np.eye(n) + 0.1 * rng.standard_normal((n, n))
    for k in range(N + 1):
        weight = 10.0 if k == N else 0.7
        qp.J[k][:3, :n] = weight * tool
        qp.r[k][:3] = -0.5 * weight
        qp.J[k][3 : 3 + n_x, :n_x] = 0.01 * np.eye(n_x)
        qp.z_lower[k][n:n_x] = -0.15
        qp.z_upper[k][n:n_x] = 0.15
        if k < N:
            qp.A[k][:] = np.kron([[1.0, dt], [0.0, 1.0]], np.eye(n))
            qp.B[k][:] = np.kron([[dt**2 / 2], [dt]], np.eye(n))
            qp.J[k][3 + n_x :, n_x:] = 0.1 * M
            qp.C[k][:, n_x:] = M
            qp.lower[k][:] = -0.3
            qp.upper[k][:] = 0.3
    if goal:
        qp.C[N][:, :n] = tool
        qp.lower[N][:] = 0.1
        qp.upper[N][:] = 0.1
    qp.flat["damping"][:] = 1e-6
    qp.fix_initial_state(np.zeros(n_x))
    return qp


def random_trajectory(rng: np.random.Generator, qp: StageQp) -> list[np.ndarray]:
    n_x = qp.shape.n_x
    fixed = np.isfinite(qp.z_lower[0][: n_x[0]])
    x = np.where(fixed, qp.z_lower[0][: n_x[0]], rng.standard_normal(n_x[0]))
    states = []
    for k, n_z in enumerate(qp.shape.n_z):
        states.append(np.concatenate([x, rng.standard_normal(n_z - n_x[k])]))
        if k < qp.shape.N:
            x = qp.dynamics[k] @ states[-1] + qp.b[k]
    return states


def dense(qp: StageQp) -> tuple[np.ndarray, ...]:
    """H, g, A, lower and upper of all stages at once, dynamics as rows."""
    begin = np.concatenate([[0], np.cumsum(qp.shape.n_z)])
    n = int(begin[-1])
    H = np.zeros((n, n))
    g = np.zeros(n)
    A = []
    lower = []
    upper = []
    for k in range(qp.shape.N + 1):
        stage = slice(begin[k], begin[k + 1])
        H[stage, stage] = qp.J[k].T @ qp.J[k] + qp.H[k] + np.diag(qp.damping[k])
        g[stage] = qp.J[k].T @ qp.r[k] + qp.g[k]
        rows = np.zeros((qp.shape.n_c[k], n))
        rows[:, stage] = qp.C[k]
        A = [*A, rows]
        lower = [*lower, qp.lower[k]]
        upper = [*upper, qp.upper[k]]
        if k < qp.shape.N:
            rows = np.zeros((qp.shape.n_x[k + 1], n))
            rows[:, stage] = qp.dynamics[k]
            rows[:, begin[k + 1] : begin[k + 1] + qp.shape.n_x[k + 1]] -= np.eye(
                qp.shape.n_x[k + 1]
            )
            A = [*A, rows]
            lower = [*lower, -qp.b[k]]
            upper = [*upper, -qp.b[k]]
    return H, g, np.vstack(A), np.concatenate(lower), np.concatenate(upper)


def conic_optimum(qp: StageQp, plugin: str, **options: object) -> np.ndarray:
    H, g, A, lower, upper = dense(qp)
    shape = {"h": ca.DM(H).sparsity(), "a": ca.DM(A).sparsity()}
    solver = ca.conic("oracle", plugin, shape, {"error_on_fail": True, **options})
    bounds = {"lbx": qp.flat["z_lower"], "ubx": qp.flat["z_upper"]}
    return np.array(solver(h=H, g=g, a=A, lba=lower, uba=upper, **bounds)["x"]).ravel()


def softened(qp: StageQp, l1: float, l2: float) -> np.ndarray:
    """The optimum where all rows but dynamics may be missed by slacks, which are variables here."""
    H, g, A, lower, upper = dense(qp)
    begin = 0
    rows = []
    for k, n in enumerate(qp.shape.n_c):
        rows += range(begin, begin + n)
        begin += n + (qp.shape.n_x[k + 1] if k < qp.shape.N else 0)
    m = len(rows)
    n = len(g)
    slack = np.zeros((len(A), 2 * m))
    slack[rows] = np.hstack([np.eye(m), -np.eye(m)])
    H = np.block([[H, np.zeros((n, 2 * m))], [np.zeros((2 * m, n)), (l2 + 1e-9) * np.eye(2 * m)]])
    shape = {"h": ca.DM(H).sparsity(), "a": ca.DM(np.hstack([A, slack])).sparsity()}
    optimum = ca.conic("oracle", "daqp", shape, {"error_on_fail": True})(
        h=H,
        g=np.concatenate([g, np.full(2 * m, l1)]),
        a=np.hstack([A, slack]),
        lba=lower,
        uba=upper,
        lbx=np.concatenate([qp.flat["z_lower"], np.zeros(2 * m)]),
        ubx=np.concatenate([qp.flat["z_upper"], np.full(2 * m, np.inf)]),
    )
    return np.array(optimum["x"]).ravel()[:n]


def flat(parts: tuple[np.ndarray, ...]) -> np.ndarray:
    return np.concatenate(parts)


def kkt_failure(qp: StageQp, solution: StageQpSolution) -> float:
    """Largest failure of the optimality conditions of hard rows, from the data alone."""
    H, g, A, lower, upper = dense(qp)
    z = flat(solution.z)
    y_z = flat(solution.y_z)
    y = []
    for k in range(qp.shape.N + 1):
        y.append(solution.y[k])
        if k < qp.shape.N:
            y.append(solution.costate[k + 1])
    rows = np.concatenate(y)
    everything = [(A @ z, lower, upper, rows), (z, qp.flat["z_lower"], qp.flat["z_upper"], y_z)]
    failures = [np.abs(H @ z + g + A.T @ rows + y_z).max()]
    for value, low, high, multiplier in everything:
        failures += [(low - value).max(initial=0.0), (value - high).max(initial=0.0)]
        above = np.maximum(multiplier, 0.0)
        below = np.maximum(-multiplier, 0.0)
        failures += [
            np.minimum(above, high - value).max(initial=0.0),
            np.minimum(below, value - low).max(initial=0.0),
        ]
    return float(max(failures))
