"""do-mpc: a discrete linear model, IPOPT through CasADi, reference and bounds over the horizon.

Soft bounds are do-mpc's own; the state is ``(x, u(k-1))`` and the input the increment.
"""

import do_mpc
import numpy as np

PACKAGES = ("do_mpc", "casadi")
_FAR = 1e8


def _step(task):
    A, B, last, C, E = task.augmented()
    n, n_u = B.shape
    N, n_y, n_e = task.N, task.n_y, task.n_e
    model = do_mpc.model.Model("discrete")
    x = model.set_variable("_x", "x", shape=(n, 1))
    du = model.set_variable("_u", "du", shape=(n_u, 1))
    w = model.set_variable("_tvp", "w", shape=(n_y, 1))
    low = model.set_variable("_tvp", "low", shape=(n_e, 1))
    high = model.set_variable("_tvp", "high", shape=(n_e, 1))
    model.set_rhs("x", A @ x + B @ du)
    model.setup()
    mpc = do_mpc.controller.MPC(model)
    settings = mpc.settings
    settings.n_horizon, settings.t_step, settings.store_full_solution = N, 1.0, False
    settings.nlpsol_opts = {
        "ipopt.print_level": 0, "print_time": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-10,
        "ipopt.warm_start_init_point": "yes", "ipopt.hessian_constant": "yes",
        "ipopt.jac_c_constant": "yes", "ipopt.jac_d_constant": "yes", "ipopt.mu_init": 1e-4,
        "ipopt.nlp_scaling_method": "none",  # the prices of slack would scale the tolerance away
    }  # fmt: skip
    # Stage k sees the state that its input leads to: what holds at step k + 1.
    ahead = A @ x + B @ du
    error = C @ ahead - w
    stage = (error.T @ np.diag(task.output_weight) @ error) + (
        du.T @ np.diag(task.increment_weight) @ du
    )
    mpc.set_objective(lterm=stage, mterm=0 * x[0])
    mpc.set_rterm(du=0.0)
    command = last @ ahead
    for name, expression, bound, price in [
        *((f"high{j}", E[j : j + 1] @ ahead - high[j], 0.0, task.linear[j]) for j in range(n_e)),
        *((f"low{j}", low[j] - E[j : j + 1] @ ahead, 0.0, task.linear[j]) for j in range(n_e)),
    ]:
        mpc.set_nl_cons(name, expression, bound, soft_constraint=True, penalty_term_cons=price)
    bounds = task.bounds(0)
    for j in range(n_u):
        # do-mpc keeps bounds on expressions constant: the tightest of the horizon.
        mpc.set_nl_cons(f"top{j}", command[j], float(bounds.command[1, :, j].min()))
        mpc.set_nl_cons(f"bottom{j}", -command[j], float(-bounds.command[0, :, j].max()))
    fast = np.clip(bounds.rate, -_FAR, _FAR)
    mpc.bounds["lower", "_u", "du"] = fast[0].max(axis=0)
    mpc.bounds["upper", "_u", "du"] = fast[1].min(axis=0)
    template = mpc.get_tvp_template()

    def limit(bounds):
        for i in range(N):
            template["_tvp", i, "low"] = np.clip(bounds.output[0, i], -_FAR, _FAR)
            template["_tvp", i, "high"] = np.clip(bounds.output[1, i], -_FAR, _FAR)

    limit(bounds)
    mpc.set_tvp_fun(lambda _: template)
    mpc.setup()
    p = np.zeros(n)
    mpc.x0 = p
    mpc.set_initial_guess()

    def step(state, previous, reference, moved):
        if moved is not None:
            limit(moved)
        p[: task.n], p[task.n :] = state, previous
        for i in range(N):
            template["_tvp", i, "w"] = reference[i]
        answer = mpc.make_step(p)
        return answer[:, 0] if mpc.solver_stats["success"] else np.nan

    return step


VARIANTS = {"IPOPT": ("soft bounds", _step)}
