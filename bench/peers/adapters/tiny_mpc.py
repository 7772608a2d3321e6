"""TinyMPC: ADMM on Riccati recursions, persistent.

TinyMPC has hard bounds, and it closes the horizon with the cost of the infinite one, which cannot
be switched off: what it solves has another optimum. That cost exists only for states that the input
reaches. So the state is the part that increments add, zero at the start, and the free response is
taken off reference and bounds in each cycle. (With all states, disturbances among them, its Riccati
recursion ends in gains that drive every command into its bound.)
"""

import numpy as np
import tinympc

PACKAGES = ("tinympc",)
_FAR = 1e6
_RHO, _TOLERANCE, _ITERATIONS = 1e-3, 1e-4, 1000
"""rho is part of the end cost too: with 1e-6 the answers are those of the infinite-horizon LQR."""
_CHECK = 5
"""Iterations between checks: a check after the first one passes before a new reference is seen."""


def _reached(A, B):
    """Return an orthonormal basis of what the input can reach, ``(n, r)``."""
    blocks = [B]
    for _ in range(len(A) - 1):
        block = A @ blocks[-1]
        blocks.append(block / np.linalg.norm(block))
    left, sizes, _ = np.linalg.svd(np.hstack(blocks))
    return left[:, : int((sizes > 1e-10 * sizes[0]).sum())]


def _step(task):
    A, B, last, C, E = task.augmented()
    n_u, n_y, n_e, N = task.n_u, task.n_y, task.n_e, task.N
    V = _reached(A, B)
    seen = np.vstack([C, E, last])
    m, r = len(seen), V.shape[1]
    # The state: outputs, bounded outputs, command; then the coordinates that they follow from.
    A_ = np.block([[np.zeros((m, m)), seen @ A @ V], [np.zeros((r, m)), V.T @ A @ V]])
    B_ = np.vstack([seen @ B, V.T @ B])
    size = m + r
    free, power = [np.zeros((m, len(A)))], np.eye(len(A))
    for _ in range(N):
        power = A @ power
        free.append(seen @ power)
    free_map = np.vstack(free)
    Q = np.zeros(size)
    Q[:n_y] = task.output_weight
    solver = tinympc.TinyMPC()
    solver.setup(
        A_, B_, np.diag(Q), np.diag(task.increment_weight), N + 1, rho=_RHO, verbose=False,
        abs_pri_tol=_TOLERANCE, abs_dua_tol=_TOLERANCE, max_iter=_ITERATIONS,
        check_termination=_CHECK,
    )  # fmt: skip
    state_low, state_high = np.full((2, m, N + 1), 0.0)
    low, high = np.full((size, N + 1), -_FAR), np.full((size, N + 1), _FAR)
    rate = np.zeros((2, n_u, N))
    wished, p, start = np.zeros((size, N + 1)), np.zeros(len(A)), np.zeros(size)

    def limit(bounds):
        for side, far, i in ((state_low, -_FAR, 0), (state_high, _FAR, 1)):
            side[:] = far
            side[n_y : n_y + n_e, 1:] = bounds.output[i].T
            side[n_y + n_e :, 1:] = bounds.command[i].T
            rate[i] = np.clip(bounds.rate[i].T, -_FAR, _FAR)
        np.clip(state_low, -_FAR, _FAR, out=state_low)
        np.clip(state_high, -_FAR, _FAR, out=state_high)

    def step(state, previous, reference, moved):
        if moved is not None:
            limit(moved)
        p[: task.n], p[task.n :] = state, previous
        without = np.dot(free_map, p).reshape(N + 1, m).T
        wished[:n_y, 1:] = reference.T
        wished[:n_y, 1:] -= without[:n_y, 1:]
        np.subtract(state_low, without, out=low[:m])
        np.subtract(state_high, without, out=high[:m])
        solver.set_bound_constraints(low, high, rate[0], rate[1])
        solver.set_x0(start)
        solver.set_x_ref(wished)
        return solver.solve()["controls"]

    return step


VARIANTS = {"ADMM": ("hard bounds, infinite-horizon end cost", _step)}
