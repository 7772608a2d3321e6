"""acados: an OCP with soft bounds of its own, code generated and compiled, Cython interface, RTI.

The state is turned so that every bound is one on a state; the input is the increment. A linear
problem takes one iteration, which `SQP_RTI` makes.
"""

import os
import sys
from pathlib import Path

import acados
import numpy as np

PACKAGES = ("comma-deps-acados", "casadi", "cython")
_FAR = 1e8


def _root():
    """Lay the wheel's files out as the generated Makefile expects a source tree."""
    root = Path("root")
    (root / "interfaces" / "acados_template").mkdir(parents=True, exist_ok=True)
    package = Path(acados.__file__).parent
    for name in ("include", "lib", "bin"):  # real folders: the Makefile goes up from them
        (root / name).mkdir(exist_ok=True)
        for item in (package / "install" / name).iterdir():
            _link(root / name / item.name, item)
    _link(root / "interfaces" / "acados_template" / "acados_template", Path(acados.TEMPLATE_DIR))
    os.environ["ACADOS_SOURCE_DIR"] = str(root.resolve())
    # The Makefile calls "cython", and the solver loads its libraries by name.
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    sys.path[:0] = [str(package), str(Path.cwd())]  # its own imports, and the generated module
    return root.resolve()


def _link(link, target):
    if not link.is_symlink():
        link.symlink_to(target)


def _solver(task, qp_solver):
    root = _root()
    from acados_template import AcadosModel, AcadosOcp, AcadosOcpSolver
    from casadi import SX

    A, B, last, C, E = task.augmented()
    n_u, n_e, n_y, N = task.n_u, task.n_e, task.n_y, task.N
    # Coordinates of the state: bounded outputs, u(k-1), then what is left.
    head = np.vstack([E, last])
    assert np.linalg.matrix_rank(head) == len(head), "bounds must be on independent outputs"
    T = np.vstack([head, np.linalg.svd(head)[2][len(head) :]])
    back = np.linalg.inv(T)
    A_, B_, C_ = T @ A @ back, T @ B, C @ back
    size = len(A)
    model = AcadosModel()
    model.name = f"axis_{qp_solver.lower()}"
    model.x, model.u = SX.sym("x", size), SX.sym("u", n_u)
    model.disc_dyn_expr = A_ @ model.x + B_ @ model.u
    ocp = AcadosOcp(acados_path=str(root))
    ocp.model = model
    ocp.dims.N = N
    cost, limits = ocp.cost, ocp.constraints
    cost.cost_type = cost.cost_type_e = "LINEAR_LS"
    # acados weights stages by their length in time: see time_steps below.
    cost.W = 2 * np.diag(np.concatenate([task.output_weight, task.increment_weight]))
    cost.W_e = 2 * np.diag(task.output_weight)
    cost.Vx = np.zeros((n_y + n_u, size))
    cost.Vx[:n_y] = C_
    cost.Vu = np.vstack([np.zeros((n_y, n_u)), np.eye(n_u)])
    cost.Vx_e = cost.Vx[:n_y]
    cost.yref, cost.yref_e = np.zeros(n_y + n_u), np.zeros(n_y)
    bounded = np.arange(n_e + n_u)
    limits.x0 = np.zeros(size)
    for end in ("", "_e"):
        setattr(limits, f"idxbx{end}", bounded)
        setattr(limits, f"lbx{end}", np.full(bounded.size, -_FAR))
        setattr(limits, f"ubx{end}", np.full(bounded.size, _FAR))
        setattr(limits, f"idxsbx{end}", np.arange(n_e))
        for side in ("zl", "zu"):
            setattr(cost, f"{side}{end}", np.array(task.linear, dtype=float))
        for side in ("Zl", "Zu"):
            setattr(cost, f"{side}{end}", 2 * np.array(task.quadratic, dtype=float))
    if np.isfinite(task.rate).any():
        limits.idxbu = np.arange(n_u)
        limits.lbu, limits.ubu = np.full(n_u, -_FAR), np.full(n_u, _FAR)
    options = ocp.solver_options
    options.tf, options.time_steps = float(N), np.ones(N)
    options.integrator_type, options.nlp_solver_type = "DISCRETE", "SQP_RTI"
    options.qp_solver, options.hessian_approx = qp_solver, "GAUSS_NEWTON"
    options.qp_solver_warm_start = 1
    options.qp_solver_iter_max = 200
    options.hpipm_mode = "SPEED"
    options.qp_tol = 1e-7  # with 1e-8 HPIPM runs to its iteration limit: 6 and 16 times as slow
    if "PARTIAL" in qp_solver:
        options.qp_solver_cond_N = N
    file = f"{model.name}.json"
    ocp.code_export_directory = str(Path(f"code_{model.name}").resolve())
    AcadosOcpSolver.generate(ocp, json_file=file)
    AcadosOcpSolver.build(ocp.code_export_directory, with_cython=True, verbose=False)
    import ctypes

    for name in ("libblasfeo.so", "libhpipm.so", "libqpOASES_e.so.3.1", "libacados.so"):
        ctypes.CDLL(str(root / "lib" / name), ctypes.RTLD_GLOBAL)
    return AcadosOcpSolver.create_cython_solver(file), T


def _step(task, qp_solver):
    solver, T = _solver(task, qp_solver)
    N, n_y, n = task.N, task.n_y, task.n
    yref, last = np.zeros((N + 1, n_y + task.n_u)), np.zeros(n_y)
    x, p = np.zeros(len(T)), np.zeros(len(T))

    def limit(bounds):
        for i in range(1, N + 1):
            command = bounds.command[:, i - 1]
            # Bounds on outputs that no decision moves are facts: none is stated for them.
            both = np.concatenate([bounds.output[:, i - 1], command], axis=1)
            both = np.clip(both, -_FAR, _FAR)
            solver.constraints_set(i, "lbx", both[0])
            solver.constraints_set(i, "ubx", both[1])
        if np.isfinite(task.rate).any():
            for i in range(N):
                fast = np.clip(bounds.rate[:, i], -_FAR, _FAR)
                solver.constraints_set(i, "lbu", fast[0])
                solver.constraints_set(i, "ubu", fast[1])

    def step(state, previous, reference, moved):
        if moved is not None:
            limit(moved)
        p[:n], p[n:] = state, previous
        np.dot(T, p, out=x)
        yref[1:, :n_y] = reference
        for i in range(1, N):
            solver.set(i, "yref", yref[i])
        last[:] = yref[N, :n_y]
        solver.set(N, "yref", last)
        solver.set(0, "lbx", x)
        solver.set(0, "ubx", x)
        status = solver.solve()
        return solver.get(0, "u") if status == 0 else np.nan

    return step


VARIANTS = {
    name: ("soft bounds", lambda task, qp_solver=qp_solver: _step(task, qp_solver))
    for name, qp_solver in (
        ("full condensing, qpOASES", "FULL_CONDENSING_QPOASES"),
        ("full condensing, HPIPM", "FULL_CONDENSING_HPIPM"),
        ("HPIPM", "PARTIAL_CONDENSING_HPIPM"),
    )
}
