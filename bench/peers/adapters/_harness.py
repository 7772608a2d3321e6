"""Runs one adapter in the peer's own environment: sets up, then makes a pass whenever asked.

    python -I _harness.py ADAPTER.py TASK.npz RESULT.npz [VARIANT]

An adapter is a file with ``VARIANTS``, a mapping from a name to ``(what it solves, set-up)``, and
``PACKAGES``, the distributions whose versions are told. Set-up takes the `Task` and returns a
function ``step(state, previous, reference, moved)`` that does all that a user has to do in one
cycle and returns the first increment, ``(n_u,)`` or a number; NaN where the package gives no
answer. ``moved`` is None, or the `Bounds` that hold from this cycle on. Cycles come in their order.
``step.begin()``, if there is one, is called before the first of each pass. Outside the clock,
behind each cycle: ``step.increment(previous)``, where a package ends with the command and not with
the increment, and ``step.after()``, for what a loop does once the command has gone out.

Nothing here but numpy and the standard library: other Python versions run it too. Isolated mode
(``-I``) keeps the working directory and PYTHONPATH out of the imports, so that ``import qpmpc`` is
the package of the peer's environment and no other.

Standard output, as it was at the start, carries one JSON line after set-up and one after each pass;
whatever packages print goes to standard error. Standard input carries a line ``pass`` for each pass
wanted; its end asks for the result.
"""

import gc
import importlib.metadata
import importlib.util
import json
import os
import platform
import sys
from pathlib import Path
from time import perf_counter_ns

import numpy as np

WARM_UP = 200
"""Cycles before the first pass, off the clock."""


class Bounds:
    """Bounds of one cycle, lower and upper side by side; infinite: none.

    ``command (2, N, n_u)``, ``rate (2, N, n_u)``, ``output (2, N, n_e)`` for the rows of ``E``,
    and ``rows (2, m)``: those of the condensed QP, before ``row_map`` is taken off.
    """

    def __init__(self, command, rate, output, rows):
        self.command, self.rate, self.output, self.rows = command, rate, output, rows


class Task:
    """The problem as ``bench/peers/task.py`` writes it: every array an attribute."""

    def __init__(self, path):
        with np.load(path, allow_pickle=False) as file:
            for key in file.files:
                array = file[key]
                setattr(self, key, array.item() if array.ndim == 0 else array)
        self.n, self.n_u = self.B.shape
        self.n_y, self.n_e, self.cycles = len(self.C), len(self.E), len(self.state)
        self.n_d = len(self.P)

    def bounds(self, k):
        """Return the bounds of cycle ``k``."""
        return Bounds(self.command[k], self.rate[k], self.output[k], self.rows[k])

    def augmented(self):
        """Return A, B, and the matrices that read u(k-1), y and E x from the state ``(x, u(k-1))``.

        The input of this model is the increment.
        """
        n, n_u = self.n, self.n_u
        A = np.block([[self.A, self.B], [np.zeros((n_u, n)), np.eye(n_u)]])
        B = np.vstack([self.B, np.eye(n_u)])

        def widened(M):
            return np.hstack([M, np.zeros((len(M), n_u))])

        last = np.hstack([np.zeros((n_u, n)), np.eye(n_u)])
        return A, B, last, widened(self.C), widened(self.E)


def load(path):
    """Import an adapter from its file; what lies beside it may be imported, too."""
    sys.path.append(str(path.parent))
    spec = importlib.util.spec_from_file_location("adapter", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["adapter"] = module
    spec.loader.exec_module(module)
    return module


def main():
    """Set the adapter up and serve passes until standard input ends."""
    adapter, task_file, result = (Path(a).resolve() for a in sys.argv[1:4])
    channel = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what packages print must not be taken for an answer
    task = Task(task_file)
    module = load(adapter)
    name = sys.argv[4] if len(sys.argv) > 4 else next(iter(module.VARIANTS))
    solves, set_up = module.VARIANTS[name]
    step = set_up(task)
    cycles = task.cycles
    inputs = [
        (
            np.array(task.state[k]),
            np.array(task.previous[k]),
            np.array(task.reference[k]),
            task.bounds(k) if k == 0 or task.moved[k] else None,
        )
        for k in range(cycles)
    ]
    begin_pass = getattr(step, "begin", lambda: None)
    after = getattr(step, "after", lambda: None)
    increment = getattr(step, "increment", None)
    begin_pass()
    for cycle in inputs[:WARM_UP]:
        step(*cycle)
        after()
    packages = getattr(module, "PACKAGES", ())
    told = {
        "solves": solves,
        "python": platform.python_version(),
        "versions": {p: importlib.metadata.version(p) for p in packages},
    }
    channel.write(json.dumps(told) + "\n")
    gc.collect()
    gc.freeze()
    gc.disable()
    times, increments = [], []
    for line in sys.stdin:
        if line.strip() != "pass":
            continue
        took = np.zeros(cycles, dtype=np.int64)
        answers = np.full((cycles, task.n_u), np.nan)
        begin_pass()
        for k in range(cycles):
            state, previous, reference, moved = inputs[k]
            begin = perf_counter_ns()
            answer = step(state, previous, reference, moved)
            end = perf_counter_ns()
            took[k] = end - begin
            answers[k] = answer if increment is None else increment(previous)
            after()
        times.append(took)
        increments.append(answers)
        gc.collect()
        channel.write(json.dumps({"seconds": float(took.sum()) * 1e-9}) + "\n")
    np.savez(result, times=np.array(times), increments=np.array(increments))


if __name__ == "__main__":
    main()
