"""How a solve, and a cycle, ended: one enum for every backend."""

from __future__ import annotations

from enum import StrEnum


class Status(StrEnum):
    """Outcome of a solve, or of a cycle of the controller."""

    SOLVED = "solved"
    """The answer satisfies the optimality conditions, checked by the library."""
    CLIPPED = "clipped"
    """The answer left the bounds on the command and was clipped to them."""
    INACCURATE = "inaccurate"
    """The solver called its answer optimal, and the check found that it is not."""
    ITERATION_LIMIT = "iteration_limit"
    """Stopped at the limit of iterations or time, without an answer that passes the check."""
    INFEASIBLE = "infeasible"
    """No decision satisfies the hard rows."""
    UNBOUNDED = "unbounded"
    """The cost has no lower end within the rows: P is only semidefinite, and nothing stops q."""
    LATE = "late"
    """The step's deadline passed before there was an answer; whatever came after it is not used."""
    FAILED = "failed"
    """No usable answer: NaN among the parameters or in the answer, or a numerical breakdown."""
