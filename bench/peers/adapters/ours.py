"""Our own rows: the closed form and DAQP as the library calls them, and the compiled step.

``analytic`` and ``daqp`` do what peers do: from state, last command and reference to the increment.
The compiled step does more, observer and reference too, from the measurement on; `prepare`, which
a control loop calls after the command has gone out, is on the clock as well.
"""

import numpy as np

from qpmpc import (
    CommandBound,
    Controller,
    ExponentialReference,
    KalmanObserver,
    LinearModel,
    OutputBound,
    Problem,
    RateBound,
    Solver,
)

PACKAGES = ("pulsempc", "daqp")


def _problem(task):
    model = LinearModel(task.A, task.B, task.C, float(task.period))
    first = task.bounds(0)
    bounds = [CommandBound(first.command[0], first.command[1], moving=True)]
    if np.isfinite(task.rate).any():
        bounds.append(RateBound(first.rate[0], first.rate[1], moving=True))
    for j in range(task.n_e):
        low, high = first.output[0, :, j : j + 1], first.output[1, :, j : j + 1]
        bounds.append(
            OutputBound(
                f"output{j}", task.E[j : j + 1], low, high, float(task.linear[j]),
                float(task.quadratic[j]), moving=True,
            )
        )  # fmt: skip
    return Problem(
        model,
        task.N,
        output_weight=task.output_weight,
        increment_weight=task.increment_weight,
        bounds=bounds,
    )


def _move(problem, moved):
    problem.move("command", moved.command[0], moved.command[1])
    if "rate" in problem.rows:
        problem.move("rate", moved.rate[0], moved.rate[1])
    for j in range(moved.output.shape[-1]):
        problem.move(f"output{j}", moved.output[0, :, j : j + 1], moved.output[1, :, j : j + 1])


def _interpreted(task, backend):
    problem = _problem(task)
    solver = Solver(problem.qp, backend, problem.rows.values(), pattern=problem.pattern)
    n_u = task.n_u

    def step(state, previous, reference, moved):
        if moved is not None:
            _move(problem, moved)
        problem.update(state, previous, reference)
        solution = solver.solve(problem.q, problem.l, problem.u)
        return solution.x[:n_u] if solution.usable else np.nan

    return step


def _compiled(task):
    problem = _problem(task)
    model = problem.model
    n, measured = model.n_states, np.array(task.measured)
    observer = KalmanObserver(model, measured, np.eye(n), np.eye(len(measured)))
    observer.gain[:] = task.gain
    alpha, period = float(task.alpha), model.period
    reference = ExponentialReference(
        task.N, task.n_y, period, -period / np.log(alpha) if alpha > 0 else 0.0
    )
    controller = Controller(problem, observer, reference, "daqp", compiled="on")
    compiled = controller.compiled
    command, sent = controller.command, task.previous
    cycles = task.cycles
    measurements = [np.array(row) for row in task.measurement]
    previews = [np.array(row) for row in task.preview]
    following = [np.array(sent[min(k + 1, cycles - 1)]) for k in range(cycles)]
    k = 0

    def step(state, previous, reference, moved):
        if moved is not None:
            _move(problem, moved)
        compiled.step(measurements[k], previews[k])  # the command is in `command`

    def increment(previous):
        return command - previous

    def after():
        nonlocal k
        command[:] = following[k]  # what was sent when this was recorded
        compiled.prepare()
        k += 1

    def begin():
        nonlocal k
        k = 0
        controller.reset(task.predicted[0], sent[0])

    step.begin, step.after, step.increment = begin, after, increment
    return step


VARIANTS = {
    "analytic": ("no bounds", lambda task: _interpreted(task, "analytic")),
    "daqp": ("soft bounds", lambda task: _interpreted(task, "daqp")),
    "daqp, compiled": ("soft bounds, observer and reference too", _compiled),
}
