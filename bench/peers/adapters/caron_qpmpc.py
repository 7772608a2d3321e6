"""qpmpc by S. Caron: `MPCQP` kept, its vectors updated in every cycle, solved through qpsolvers.

The state ``(x, u(k-1))`` is scaled so that the weight, one for all states, counts for the outputs
alone (the others are smaller by 1e-8). Slack is an input of its own: its target makes a linear
price, its quadratic one is the increments'.
"""

import numpy as np
import qpsolvers

from qpmpc import MPCQP, MPCProblem

PACKAGES = ("qpmpc", "qpsolvers", "daqp")
_SMALL = 1e-8


def _step(task, soft):
    A, B, last, C, E = task.augmented()
    n, n_u = B.shape
    assert task.n_y == n_u == 1, "one weight for all states, one for all inputs"
    delta, lam = float(task.output_weight[0]), float(task.increment_weight[0])
    others = np.linalg.svd(C)[2][1:]  # with C, coordinates of the state
    T = np.vstack([C, _SMALL * others])
    back = np.linalg.inv(T)
    n_s = task.n_e if soft else 0
    slack = np.zeros((n, n_s))
    # Rows of a step bound the command now and the outputs one step on.
    ahead, direct = E @ A, E @ B
    N = task.N
    C_k, D_k, keep = [], [], []
    for i in range(N):
        both = task.kept[i]
        bounded = np.isfinite(task.rate).any(axis=(0, 1, 2, 3))
        eye = np.eye(n_u)
        signs = (1.0, -1.0)
        states = [s * last for s in signs]
        inputs = [s * np.hstack([eye, np.zeros((n_u, n_s))]) for s in signs]
        if bounded:
            states += [0 * last for s in signs]
            inputs += [s * np.hstack([eye, np.zeros((n_u, n_s))]) for s in signs]
        give = -np.eye(task.n_e)[both][:, : n_s or 0] if soft else np.zeros((both.sum(), 0))
        states += [s * ahead[both] for s in signs]
        inputs += [np.hstack([s * direct[both], give]) for s in signs]
        if soft:
            states.append(np.zeros((n_s, n)))
            inputs.append(np.hstack([np.zeros((n_s, n_u)), -np.eye(n_s)]))
        C_k.append(np.vstack(states) @ back)
        D_k.append(np.vstack(inputs))
        keep.append(both)

    def sides(bounds):
        """Return the vector of each step, far where there is no bound."""
        vectors = []
        for i in range(N):
            parts = [bounds.command[1, i], -bounds.command[0, i]]
            if bounded:
                parts += [bounds.rate[1, i], -bounds.rate[0, i]]
            parts += [bounds.output[1, i][keep[i]], -bounds.output[0, i][keep[i]]]
            if soft:
                parts.append(np.zeros(n_s))
            vectors.append(np.minimum(np.concatenate(parts), 1e9))
        return vectors

    targets = np.zeros((N, n_u + n_s))
    if soft:
        targets[:, n_u:] = -task.linear / (2.0 * lam)
    problem = MPCProblem(
        T @ A @ back,
        np.hstack([T @ B, slack]),
        C_k,
        D_k,
        sides(task.bounds(0)),
        N,
        terminal_cost_weight=delta,
        stage_state_cost_weight=delta,
        stage_input_cost_weight=lam,
        initial_state=np.zeros(n),
        goal_state=np.zeros(n),
        target_states=np.zeros(N * n),
        target_inputs=targets if soft else None,
    )
    qp = MPCQP(problem)
    wished = np.zeros((N + 1, n))
    x = np.zeros(n)
    inner = n - n_u

    def step(state, previous, reference, moved):
        if moved is not None:
            qp.e[:] = np.hstack(sides(moved))
        x[:inner], x[inner:] = state, previous
        wished[1:, 0] = reference[:, 0]
        problem.update_initial_state(T @ x)
        wished[0, 0] = problem.initial_state[0]
        problem.update_target_states(wished[:-1])
        problem.update_goal_state(wished[-1])
        qp.update_cost_vector(problem)
        qp.update_constraint_vector(problem)
        solution = qpsolvers.solve_problem(qp.problem, solver="daqp", primal_tol=1e-9)
        return solution.x[:n_u] if solution.found else np.nan

    return step


VARIANTS = {
    "slack inputs, DAQP": ("soft bounds, slack as inputs", lambda task: _step(task, True)),
    "hard, DAQP": ("hard bounds", lambda task: _step(task, False)),
}
