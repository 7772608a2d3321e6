# ruff: noqa: E741 - l is the name of the lower bounds throughout the library
"""QPs that the library did not build: other robots, other forms, other units, and bad manners.

Every generator returns the same programs each time. Units are mixed on purpose: newtons beside
metres beside radians, weights from 1e-6 to 1e4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm

from qpmpc import QuadraticProgram, Status

Array = NDArray[np.float64]
INF = np.inf


@dataclass(frozen=True, eq=False)
class Foreign:
    """One QP with hard rows, and how its solve has to end."""

    name: str
    qp: QuadraticProgram
    status: Status = Status.SOLVED


def program(P: Array, q: Array, A: Array, l: Array, u: Array) -> QuadraticProgram:
    return QuadraticProgram((P + P.T) / 2, q, A, l, u)


# ---- linear MPC over a horizon, condensed or with the states as variables


@dataclass(frozen=True, eq=False)
class Plan:
    """min sum |C_x x - x_ref|^2 + |u|^2, weighted, under bounds on rows of states and inputs.

    States are ``x_1 .. x_N``, inputs ``u_0 .. u_{N-1}``; matrices that change carry the step first.
    """

    A: Array
    B: Array
    """``(N, n_x, n_u)``."""
    start: Array
    goal: Array
    """``(N, n_x)``."""
    state_weight: Array
    input_weight: Array
    rows: Array
    """Rows over ``(x_{k+1}, u_k)``, ``(n_rows, n_x + n_u)``."""
    l: Array
    """``(N, n_rows)``."""
    u: Array
    end: Array | None = None
    """Rows over ``x_N`` that the goal's last entry fixes, ``(n_end, n_x)``."""

    def _stacked(self) -> tuple[Array, Array]:
        """States ``(N n_x)`` as a function of the inputs: matrix and free response."""
        N, n_x, n_u = self.B.shape
        S, free, x = np.zeros((N, n_x, N * n_u)), np.zeros((N, n_x)), self.start
        row = np.zeros((n_x, N * n_u))
        for k in range(N):
            row = self.A @ row
            row[:, k * n_u : (k + 1) * n_u] += self.B[k]
            x = self.A @ x
            S[k], free[k] = row, x
        return S.reshape(N * n_x, N * n_u), free.ravel()

    def condensed(self) -> QuadraticProgram:
        """Inputs are the variables."""
        N, n_x, _ = self.B.shape
        S, free = self._stacked()
        Q = np.tile(self.state_weight, N)
        R = np.tile(self.input_weight, N)
        P = 2 * (S.T @ (Q[:, None] * S) + np.diag(R))
        q = 2 * S.T @ (Q * (free - self.goal.ravel()))
        of_state = np.kron(np.eye(N), self.rows[:, :n_x])
        A = of_state @ S + np.kron(np.eye(N), self.rows[:, n_x:])
        shift = of_state @ free
        l, u = self.l.ravel() - shift, self.u.ravel() - shift
        if self.end is not None:
            last = slice((N - 1) * n_x, N * n_x)
            level = self.end @ (self.goal[-1] - free[last])
            A = np.vstack([A, self.end @ S[last]])
            l, u = np.append(l, level), np.append(u, level)
        return program(P, q, A, l, u)

    def sparse(self) -> QuadraticProgram:
        """States and inputs are variables, ``(x_1, u_0, x_2, u_1, ..)``; dynamics are rows."""
        N, n_x, n_u = self.B.shape
        width = n_x + n_u
        Q, R = np.diag(self.state_weight), np.diag(self.input_weight)
        P = 2 * np.kron(np.eye(N), block_diag(Q, R))
        q = np.concatenate([np.append(-2 * Q @ goal, np.zeros(n_u)) for goal in self.goal])
        dynamics, level = np.zeros((N * n_x, N * width)), np.zeros(N * n_x)
        level[:n_x] = self.A @ self.start
        for k in range(N):
            here, at = slice(k * n_x, (k + 1) * n_x), k * width
            dynamics[here, at : at + n_x] = np.eye(n_x)
            dynamics[here, at + n_x : at + width] = -self.B[k]
            if k:
                dynamics[here, at - width : at - n_u] = -self.A
        A = np.vstack([dynamics, np.kron(np.eye(N), self.rows)])
        l, u = np.append(level, self.l), np.append(level, self.u)
        if self.end is not None:
            last = np.zeros((self.end.shape[0], N * width))
            last[:, (N - 1) * width : (N - 1) * width + n_x] = self.end
            A = np.vstack([A, last])
            l, u = np.append(l, self.end @ self.goal[-1]), np.append(u, self.end @ self.goal[-1])
        return program(P, q, A, l, u)


def sampled(A: Array, B: Array, T: float) -> tuple[Array, Array]:
    n, m = B.shape
    both = expm(T * np.block([[A, B], [np.zeros((m, n + m))]]))
    return both[:n, :n], both[:n, n:]


def both(plan: Plan) -> list[Foreign]:
    return [Foreign("condensed", plan.condensed()), Foreign("sparse", plan.sparse())]


def cart_pole(N: int, T: float, start: tuple[float, ...]) -> Plan:
    """A pole upright on a cart: m, rad and N; speeds cost nothing; unstable."""
    cart, pole, length, g = 1.0, 0.1, 0.8, 9.81
    Ac, Bc = np.zeros((4, 4)), np.zeros((4, 1))
    Ac[0, 1] = Ac[2, 3] = 1.0
    Ac[1, 2], Ac[3, 2] = -pole * g / cart, (cart + pole) * g / (cart * length)
    Bc[1, 0], Bc[3, 0] = 1.0 / cart, -1.0 / (cart * length)
    A, B = sampled(Ac, Bc, T)
    limit = np.array([1.0, 2.0, 0.25, INF, 8.0])  # position, speed, angle, rate, force
    return Plan(
        A, np.tile(B, (N, 1, 1)), np.array(start), np.zeros((N, 4)),
        np.array([10.0, 0.0, 1.0, 0.0]), np.array([1e-3]),
        np.eye(5), np.tile(-limit, (N, 1)), np.tile(limit, (N, 1)),
    )  # fmt: skip


def walking(N: int, T: float) -> Plan:
    """A humanoid's centre of mass over its feet, sideways: jerk in, zero moment point bounded.

    The support moves with each step; at the end the divergent part of the motion is at rest.
    """
    height, g = 0.8, 9.81
    A = np.array([[1, T, T * T / 2], [0, 1, T], [0, 0, 1]])
    B = np.array([[T**3 / 6], [T * T / 2], [T]])
    zmp = np.array([[1.0, 0.0, -height / g, 0.0]])
    time = T * np.arange(1, N + 1)
    foot = np.where((time // 0.8) % 2 == 0, 0.09, -0.09)
    l, u = foot - 0.03, foot + 0.03
    between = (time % 0.8 < 0.1) | (time < 0.35)  # both feet on the ground
    l[between], u[between] = -0.12, 0.12
    goal = np.zeros((N, 3))
    return Plan(
        A, np.tile(B, (N, 1, 1)), np.array([0.0, 0.1, 0.0]), goal,
        np.array([0.0, 1.0, 0.0]), np.array([1e-6]),
        zmp, l[:, None], u[:, None],
        end=np.array([[1.0, np.sqrt(height / g), 0.0]]),
    )  # fmt: skip


def quadruped(alpha: float, N: int = 10, yaw: float = 0.3) -> Plan:
    """A trotting quadruped as one rigid body: 13 states with gravity, 12 contact forces in N.

    Forces stay in friction pyramids, legs in swing are fixed at zero, and forces cost next to
    nothing.
    """
    mass, mu, T, most = 12.0, 0.4, 0.03, 80.0
    inertia = np.diag([0.05, 0.25, 0.28])
    feet = np.array(
        [[0.2, -0.14, -0.3], [0.2, 0.14, -0.3], [-0.2, -0.14, -0.3], [-0.2, 0.14, -0.3]]
    )
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    Ac = np.zeros((13, 13))  # angles, position, rates, velocity, gravity
    Ac[0:3, 6:9], Ac[3:6, 9:12], Ac[11, 12] = turn.T, np.eye(3), 1.0
    world = np.linalg.inv(turn @ inertia @ turn.T)
    B = np.zeros((N, 13, 12))
    for k in range(N):
        Bc = np.zeros((13, 12))
        for leg, at in enumerate(turn @ foot - k * T * np.array([0.4, 0, 0]) for foot in feet):
            arm = np.array([[0, -at[2], at[1]], [at[2], 0, -at[0]], [-at[1], at[0], 0]])
            Bc[6:9, 3 * leg : 3 * leg + 3] = world @ arm
            Bc[9:12, 3 * leg : 3 * leg + 3] = np.eye(3) / mass
        A, B[k] = sampled(Ac, Bc, T)
    start = np.array([0.05, -0.08, yaw - 0.1, 0, 0, 0.26, 0.3, -0.2, 0, 0.3, 0.1, -0.1, -9.81])
    goal = np.tile(start, (N, 1))
    goal[:, :12] = [0, 0, yaw, 0, 0, 0.3, 0, 0, 0.5, 0.8, 0, 0]
    goal[:, 3] = 0.8 * T * np.arange(1, N + 1)
    pyramid = np.array([[1, 0, -mu], [-1, 0, -mu], [0, 1, -mu], [0, -1, -mu]])
    one = np.vstack([pyramid, np.eye(3)])
    rows = np.hstack([np.zeros((28, 13)), np.kron(np.eye(4), one)])
    l, u = np.zeros((N, 4, 7)), np.zeros((N, 4, 7))
    for k in range(N):
        stance = np.array([1, 0, 0, 1]) if (k // 5) % 2 == 0 else np.array([0, 1, 1, 0])
        for leg in range(4):
            l[k, leg] = [-INF] * 4 + ([-INF, -INF, 0.0] if stance[leg] else [0.0] * 3)
            u[k, leg] = [0.0] * 4 + ([INF, INF, most] if stance[leg] else [0.0] * 3)
    weight = np.array([25, 25, 10, 2, 2, 50, 0, 0, 0.3, 0.2, 0.2, 0.1, 0.0])
    return Plan(
        A, B, start, goal, weight, np.full(12, alpha),
        rows, l.reshape(N, 28), u.reshape(N, 28),
    )  # fmt: skip


# ---- small ones


def definite(rng: np.random.Generator, n: int, condition: float = 1e2) -> Array:
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    return np.asarray(Q @ np.diag(np.logspace(0, np.log10(condition), n) / condition) @ Q.T)


def dense(seed: int, n: int, m: int) -> Foreign:
    """Strictly convex, dense, many active bounds."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((m, n))
    middle = A @ rng.standard_normal(n)
    room = rng.uniform(0.0, 0.5, (2, m))
    qp = program(definite(rng, n), rng.standard_normal(n), A, middle - room[0], middle + room[1])
    return Foreign(f"dense n={n} m={m}", qp)


def linear_program(seed: int, n: int, m: int) -> Foreign:
    """P = 0 within a box and some rows."""
    rng = np.random.default_rng(seed)
    A = np.vstack([np.eye(n), rng.standard_normal((m, n))])
    reach = np.append(np.ones(n), rng.uniform(0.3, 1.0, m))
    return Foreign(f"LP n={n}", program(np.zeros((n, n)), rng.standard_normal(n), A, -reach, reach))


def semidefinite(seed: int, n: int, rank: int, m: int) -> Foreign:
    """P of low rank, bounded by a box and rows."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((rank, n))
    A = np.vstack([np.eye(n), rng.standard_normal((m, n))])
    reach = np.append(np.ones(n), rng.uniform(0.5, 1.0, m))
    qp = program(root.T @ root, 3 * rng.standard_normal(n), A, -reach, reach)
    return Foreign(f"rank {rank} of {n}", qp)


def equalities(seed: int, n: int, m: int, *, rank: int | None = None) -> Foreign:
    """Equality rows alone; P definite on their null space only, where a rank is given."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((m, n))
    level = A @ rng.standard_normal(n)
    P = definite(rng, n)
    if rank is not None:
        P = np.diag(np.append(np.ones(rank), np.zeros(n - rank)))
    name = f"equalities n={n} m={m}" + ("" if rank is None else f" rank {rank}")
    return Foreign(name, program(P, rng.standard_normal(n), A, level, level))


def free_rows() -> Foreign:
    """Rows without any bound among others."""
    rng = np.random.default_rng(21)
    A = rng.standard_normal((8, 4))
    l, u = np.full(8, -0.3), np.full(8, 0.2)
    l[::2], u[::2] = -INF, INF
    return Foreign(
        "rows without bounds", program(definite(rng, 4), rng.standard_normal(4), A, l, u)
    )


def zero_rows(l: float, u: float) -> Foreign:
    """A row of zeros, which holds or cannot."""
    rng = np.random.default_rng(22)
    A = np.vstack([np.zeros((1, 3)), rng.standard_normal((3, 3))])
    qp = program(
        definite(rng, 3),
        rng.standard_normal(3),
        A,
        np.array([l, -1, -1, -1]),
        np.array([u, 1, 1, 0.0]),
    )
    holds = l <= 0 <= u
    return Foreign(
        f"row of zeros in [{l:g}, {u:g}]", qp, Status.SOLVED if holds else Status.INFEASIBLE
    )


def dependent(seed: int, *, definite_cost: bool) -> Foreign:
    """Rows and equalities twice, and once more as sums of each other."""
    rng = np.random.default_rng(seed)
    n = 6
    E, A = rng.standard_normal((2, n)), rng.standard_normal((4, n))
    x = 0.3 * rng.standard_normal(n)
    E = np.vstack([E, 2 * E[:1], E[:1] - E[1:2]])
    A = np.vstack([A, A[:2], A[0] + A[1]])
    box = np.eye(n)
    u = np.concatenate([E @ x, A @ x + 0.02, np.ones(n)])
    l = np.concatenate([E @ x, A @ x - 0.01, -np.ones(n)])
    P = definite(rng, n) if definite_cost else np.diag([1.0, 2.0, 0, 0, 0, 0])
    name = "dependent rows" + ("" if definite_cost else ", P semidefinite")
    return Foreign(name, program(P, 5 * rng.standard_normal(n), np.vstack([E, A, box]), l, u))


def badly_scaled(seed: int, *, definite_cost: bool) -> Foreign:
    """Variables in units of 1e-4 to 1e4, and rows as well."""
    rng = np.random.default_rng(seed)
    n, m = 6, 8
    unit, row = 10 ** rng.uniform(-4, 4, n), 10 ** rng.uniform(-4, 4, m)
    root = rng.standard_normal((n if definite_cost else 2, n))
    A = np.vstack([np.eye(n), rng.standard_normal((m - n, n))])
    P = (root / unit).T @ (root / unit)
    q = 3 * rng.standard_normal(n) / unit
    name = "badly scaled" + ("" if definite_cost else ", P semidefinite")
    return Foreign(name, program(P, q, row[:, None] * A / unit, -row, row))


def loose_variable(*, cost: float) -> Foreign:
    """A variable in no row."""
    A = np.array([[1.0, 1.0, 0.0]])
    qp = program(
        np.diag([1.0, 1.0, cost]),
        np.array([-3.0, 1.0, -2.0 * cost]),
        A,
        np.array([-1.0]),
        np.array([0.5]),
    )
    return Foreign(f"variable in no row, curvature {cost:g}", qp)


def smallest() -> list[Foreign]:
    one = np.ones((1, 1))
    none, empty = np.zeros(0), np.zeros((0, 1))
    return [
        Foreign("n=1 m=0", program(2 * one, np.array([3.0]), empty, none, none)),
        Foreign("n=1 m=1", program(2 * one, np.array([3.0]), one, -one[0], one[0])),
        Foreign("n=1 m=1 LP", program(0 * one, np.array([3.0]), one, -one[0], one[0])),
        Foreign("n=1 m=1 fixed", program(2 * one, np.array([3.0]), one, one[0], one[0])),
        Foreign(
            "n=3 m=0", program(np.diag([1e-3, 1, 1e3]), np.ones(3), np.zeros((0, 3)), none, none)
        ),
    ]


def degenerate(*, linear: bool) -> Foreign:
    """A vertex in which more rows meet than there are variables."""
    angle = np.linspace(0.1, 2.0, 9)
    A = np.column_stack([np.cos(angle), np.sin(angle)])
    corner = np.array([1.0, 2.0])
    P = np.zeros((2, 2)) if linear else np.eye(2)
    name = "degenerate vertex" + (", LP" if linear else "")
    return Foreign(name, program(P, np.array([-4.0, -6.0]), A, np.full(9, -INF), A @ corner))


def infeasible() -> list[Foreign]:
    rng = np.random.default_rng(31)
    A = np.vstack([rng.standard_normal((3, 4)), np.eye(4)])
    A[2] = A[0] + A[1]
    l, u = np.full(7, -1.0), np.full(7, 1.0)
    l[0], l[1], u[2] = 0.5, 0.5, 0.4
    by_rows = program(definite(rng, 4), rng.standard_normal(4), A, l, u)
    flat = program(np.zeros((4, 4)), rng.standard_normal(4), A, l, u)
    A = np.vstack([np.ones((1, 3)), np.eye(3)])
    by_bounds = program(
        np.eye(3), np.ones(3), A, np.append(4.0, -np.ones(3)), np.append(INF, np.ones(3))
    )
    E = np.array([[1.0, 2.0], [2.0, 4.0]])
    level = np.array([1.0, 3.0])
    equal = program(np.eye(2), np.zeros(2), E, level, level)
    return [
        Foreign("infeasible by rows", by_rows, Status.INFEASIBLE),
        Foreign("infeasible by rows, LP", flat, Status.INFEASIBLE),
        Foreign("infeasible by bounds", by_bounds, Status.INFEASIBLE),
        Foreign("infeasible equalities", equal, Status.INFEASIBLE),
    ]


def unbounded() -> list[Foreign]:
    A = np.array([[1.0, 1.0], [1.0, 0.0]])
    ray = program(
        np.zeros((2, 2)), np.array([-1.0, -1.0]), A, np.array([-1.0, 0.0]), np.array([INF, INF])
    )
    P = np.diag([1.0, 0.0, 0.0])
    flat = program(P, np.array([1.0, 0.0, -1.0]), np.eye(3)[:2], -np.ones(2), np.ones(2))
    along = program(
        np.array([[1.0, -1.0], [-1.0, 1.0]]),
        np.array([-1.0, -1.0]),
        np.array([[1.0, -1.0]]),
        np.array([-1.0]),
        np.array([1.0]),
    )
    return [
        Foreign("unbounded LP", ray, Status.UNBOUNDED),
        Foreign("unbounded in a variable of no row", flat, Status.UNBOUNDED),
        Foreign("unbounded along a diagonal", along, Status.UNBOUNDED),
    ]


GENERATORS: dict[str, Callable[[], list[Foreign]]] = {
    "cart-pole N=10": lambda: both(cart_pole(10, 0.05, (0.3, 0.0, 0.1, 0.0))),
    "cart-pole N=20": lambda: both(cart_pole(20, 0.05, (0.6, 0.5, -0.1, 0.1))),
    "cart-pole N=50": lambda: both(cart_pole(50, 0.02, (0.7, 0.3, 0.05, 0.0))),
    "walking N=16": lambda: both(walking(16, 0.1)),
    "walking N=40": lambda: both(walking(40, 0.05)),
    "quadruped N=10 alpha=1e-6": lambda: both(quadruped(1e-6)),
    "quadruped N=10 alpha=1e-4": lambda: both(quadruped(1e-4)),
    "dense": lambda: [dense(1, 5, 12), dense(2, 20, 60), dense(3, 40, 30)],
    "linear": lambda: [linear_program(4, 3, 4), linear_program(5, 20, 30)],
    "semidefinite": lambda: [semidefinite(6, 5, 2, 6), semidefinite(7, 30, 10, 30)],
    "equalities": lambda: [
        equalities(8, 6, 3),
        equalities(9, 6, 6),
        equalities(10, 8, 4, rank=4),
    ],
    "empty rows": lambda: [
        free_rows(),
        zero_rows(0.0, 1.0),
        zero_rows(0.0, 0.0),
        zero_rows(1.0, 2.0),
    ],
    "dependent": lambda: [dependent(s, definite_cost=d) for s, d in ((11, True), (12, False))],
    "badly scaled": lambda: [badly_scaled(s, definite_cost=s % 2 == 1) for s in (13, 14, 118, 126)],
    "loose variable": lambda: [loose_variable(cost=cost) for cost in (1.0, 1e-4, 0.0)],
    "smallest": smallest,
    "degenerate": lambda: [degenerate(linear=False), degenerate(linear=True)],
    "infeasible": infeasible,
    "unbounded": unbounded,
}
