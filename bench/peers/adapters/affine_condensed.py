"""affine-mpc: `CondensedMPC` on OSQP with its own tolerance, set up once; vectors in each cycle.

Slack is an input with a reference below zero, which makes a linear price; two states for each soft
output carry it to the limits of states, of which affine-mpc knows one pair for the whole horizon.
(`SparseMPC` was slower by a factor of 30 on these problems and answered fewer.)
"""

import affine_mpc
import numpy as np

PACKAGES = ("affine_mpc",)
_QUADRATIC = 1e-2
"""Weight of slack; its reference is where the linear price comes out right."""
_PRICE = 0.1
"""Linear price of the unit in which slack is measured: OSQP converges best with small ones."""


def _step(task, soft):
    A, B, _, C, E = task.augmented()
    n, n_u = B.shape
    n_s = task.n_e if soft else 0
    # Further states: outputs, then what the bounds see from below and above.
    rows = np.vstack([C, E, E])
    unit = _PRICE / np.where(np.isfinite(task.linear), task.linear, _PRICE)
    eye = np.eye(task.n_e)[:, :n_s]
    rows[task.n_y :] /= np.tile(unit, 2)[:, None]
    give = np.vstack([np.zeros((task.n_y, n_s)), eye, -eye])
    m = len(rows)
    A_ = np.block([[A, np.zeros((n, m))], [rows @ A, np.zeros((m, m))]])
    B_ = np.block([[B, np.zeros((n, n_s))], [rows @ B, give]])
    size, n_i = n + m, n_u + n_s
    options = affine_mpc.Options(use_input_cost=True, saturate_states=True)
    mpc = affine_mpc.CondensedMPC(size, n_i, task.N, options)
    mpc.setModelDiscrete(np.asfortranarray(A_), np.asfortranarray(B_), np.zeros(size))
    weights = np.zeros(size)
    weights[n : n + task.n_y] = task.output_weight
    effort = np.concatenate([task.increment_weight, np.full(n_s, _QUADRATIC)])
    mpc.setWeights(weights, effort)
    if soft:
        target = np.concatenate([np.zeros(n_u), -task.linear * unit / (2 * _QUADRATIC)])
        mpc.setReferenceInput(target)
    far = 1e10
    first = np.flatnonzero(task.kept.any(axis=1))[0]

    def limit(bounds):
        low, high = np.full(size, -far), np.full(size, far)
        inner = n - n_u
        low[inner:n], high[inner:n] = bounds.command[0].max(axis=0), bounds.command[1].min(axis=0)
        low[n + task.n_y : size - task.n_e] = bounds.output[0, first:].max(axis=0) / unit
        high[size - task.n_e :] = bounds.output[1, first:].min(axis=0) / unit
        mpc.setStateLimits(np.maximum(low, -far), np.minimum(high, far))
        fast = np.clip(bounds.rate, -far, far)
        lowest = np.concatenate([fast[0].max(axis=0), np.zeros(n_s)])
        highest = np.concatenate([fast[1].min(axis=0), np.full(n_s, far)])
        mpc.setInputLimits(lowest, highest)

    limit(task.bounds(0))
    settings = affine_mpc.OSQPSettings()
    settings.verbose = 0
    if not mpc.initializeSolver(settings):
        raise RuntimeError("initializeSolver() failed")
    x, wished = np.zeros(size), np.zeros((task.N, size))
    flat = wished.reshape(-1)
    inner, fine = n - n_u, affine_mpc.SolveStatus.Success

    def step(state, previous, reference, moved):
        if moved is not None:
            limit(moved)
        x[:inner], x[inner:n] = state, previous
        wished[:, n : n + task.n_y] = reference
        mpc.setReferenceStateTrajectory(flat)
        if mpc.solve(x) != fine:
            return np.nan
        return mpc.getNextInput()[:n_u]

    return step


VARIANTS = {
    "slack inputs": ("soft bounds, slack as inputs", lambda task: _step(task, True)),
    "hard": ("hard bounds", lambda task: _step(task, False)),
}
