"""lmpc: linear MPC of Julia's LinearMPC on DAQP, soft output bounds of its own.

The package downloads Julia when it is imported. Its increments' weight and u(k-1) are its own; its
soft bounds are priced by their square, which is another optimum where they give way.
"""

import lmpc
import numpy as np

PACKAGES = ("lmpc",)
_FAR = 1e6


def _step(task):
    N, n_y, n_e = task.N, task.n_y, task.n_e
    mpc = lmpc.MPC(task.A, task.B, C=np.vstack([task.C, task.E]), Np=N)
    weights = np.concatenate([task.output_weight, np.zeros(n_e)])
    mpc.set_objective(Q=np.diag(weights), R=0.0, Rr=np.diag(task.increment_weight))
    first = task.bounds(0)
    mpc.set_input_bounds(umin=first.command[0].max(axis=0), umax=first.command[1].min(axis=0))
    kept = np.flatnonzero(task.kept.any(axis=1)) + 1
    low, high = (np.clip(first.output[i, kept - 1], -_FAR, _FAR) for i in (0, 1))
    free = np.full(n_y, _FAR)
    mpc.set_output_bounds(
        ymin=np.concatenate([-free, low.max(axis=0)]),
        ymax=np.concatenate([free, high.min(axis=0)]),
        ks=kept.tolist(),
        soft=True,
    )
    mpc.settings({"reference_preview": True})
    mpc.setup()
    wished = np.zeros((n_y + n_e, N))

    def step(state, previous, reference, moved):
        if moved is not None and not np.allclose(moved.rows, first.rows):
            return np.nan  # bounds are fixed at set-up
        wished[:n_y] = reference.T
        return np.asarray(mpc.compute_control(state, r=wished, uprev=previous)) - previous

    return step


VARIANTS = {"DAQP": ("soft bounds, quadratic price", _step)}
