"""The force-control problem built by CasADi: the same matrices, each by differentiating what it is.

Where numpy writes a formula down, CasADi is told the thing itself: the differential equations of
the contact, the recursion over the horizon, the cost. Its automatic differentiation finds the
matrices. So each construction checks the other, and a plant that is only known as a CasADi
function becomes a model by `linearise`. CasADi is imported when something is built.
"""

from __future__ import annotations

from math import ceil, log2
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from qpmpc.arrays import Array, matrix, vector
from qpmpc.contact import ContactModel
from qpmpc.errors import ModelError, ShapeError
from qpmpc.models import LinearModel
from qpmpc.prediction import Prediction, check_horizons

if TYPE_CHECKING:
    import casadi

    from qpmpc.construction import Construction, Decision

Expression = Any
"""A CasADi expression, SX or MX."""

_ORDER = 16
"""Of the series for the matrix exponential: 0.5^17 / 17! is far below a rounding error."""


class CasadiConstruction:
    """The matrices of `NumpyConstruction`, from symbolic expressions."""

    def contact(
        self,
        stiffness: float,
        velocity_damping: float,
        period: float,
        *,
        lag: float,
        separate_tool: bool,
    ) -> ContactModel:
        """Differentiate and discretise the equations in `qpmpc.contact`; see `Construction`.

        Raises:
            ModelError: a figure is out of range.
        """
        import casadi as ca  # noqa: PLC0415 - only what is built here needs it

        if not stiffness > 0:
            raise ModelError(f"stiffness must be positive, got {stiffness} N/m")
        if not velocity_damping >= 0:
            raise ModelError(f"velocity_damping must not be negative, got {velocity_damping} 1/s")
        if not lag >= 0:
            raise ModelError(f"lag must not be negative, got {lag} s")
        y, v = ca.SX.sym("y"), ca.SX.sym("v")  # force, velocity (relative, if the tool is apart)
        tool, actual = ca.SX.sym("tool"), ca.SX.sym("actual")  # tool velocity, lagged command
        u, d, v_e = ca.SX.sym("u"), ca.SX.sym("d"), ca.SX.sym("v_e")
        acceleration = actual if lag > 0 else u
        states = [y, v]
        rates = [stiffness * (v - v_e), acceleration - velocity_damping * v + d]
        if separate_tool:
            states.append(tool)
            rates.append(acceleration - velocity_damping * tool)
        if lag > 0:
            states.append(actual)
            rates.append((u - actual) / lag)
        inputs = ca.vertcat(u, d, v_e)
        ode = ca.Function("contact", [ca.vertcat(*states), inputs], [ca.vertcat(*rates)])
        n = len(states)
        A, B = _exact_hold(ode, np.zeros(n), np.zeros(3), period)
        force, reading = np.zeros((1, n)), np.zeros((1, n))
        force[0, 0], reading[0, 2 if separate_tool else 1] = 1.0, 1.0
        model = LinearModel(A, B[:, :1], force, period)
        return ContactModel(model, B[:, 1:2], B[:, 2:], reading)

    def prediction(
        self,
        model: LinearModel,
        horizon: int,
        moves: int,
        output: ArrayLike | None,
        decision: Decision,
    ) -> Prediction:
        """Roll the model out over the horizon and differentiate the outputs; see `Construction`.

        Raises:
            ModelError: N or N_u out of range. ShapeError: ``output`` does not fit the states.
        """
        import casadi as ca  # noqa: PLC0415 - only what is built here needs it

        check_horizons(horizon, moves)
        n, n_u = model.n_states, model.n_inputs
        read = model.C if output is None else matrix("output", output, columns=n)
        A, B, C = (ca.sparsify(ca.DM(M)) for M in (model.A, model.B, read))
        x0, previous = ca.MX.sym("x", n), ca.MX.sym("u", n_u)
        z = ca.MX.sym("z", n_u * moves)
        x, u, outputs = x0, previous, []
        for i in range(horizon):
            if i < moves:
                move = z[i * n_u : (i + 1) * n_u]
                u = u + move if decision == "increment" else move
            x = A @ x + B @ u
            outputs.append(C @ x)
        y_hat = ca.vertcat(*outputs)
        Psi, Upsilon, Theta = _derivatives([(y_hat, x0), (y_hat, previous), (y_hat, z)])
        return Prediction(Psi, Upsilon, Theta)

    def cost(self, Theta: Array, delta: Array, lam: Array) -> tuple[Array, Array]:
        """Differentiate the cost twice, by the decision and by the error; see `Construction`."""
        import casadi as ca  # noqa: PLC0415 - only what is built here needs it

        rows, n = Theta.shape
        z, error = ca.MX.sym("z", n), ca.MX.sym("error", rows)  # error: reference - free response
        miss = ca.sparsify(ca.DM(Theta)) @ z - error
        cost = ca.dot(ca.DM(delta) * miss, miss) + ca.dot(ca.DM(lam) * z, z)
        gradient = ca.gradient(cost, z)
        P, error_to_q = _derivatives([(gradient, z), (gradient, error)])
        return (P + P.T) / 2, error_to_q


CASADI: Construction = CasadiConstruction()
"""The construction that the backends of CasADi bring along."""


def linearise(
    ode: casadi.Function,
    state: ArrayLike,
    command: ArrayLike,
    period: float,
    output: ArrayLike,
) -> LinearModel:
    """Make a model of a plant that is given as a CasADi function, around one operating point.

    The derivatives are exact, and so is the discretisation for a command held over each period.
    States, commands and outputs of the model are deviations from the point, which should be an
    equilibrium: elsewhere the plant drifts away from it, and the model does not say so.

    Args:
        ode: ``casadi.Function`` ``f(x, u) -> dx/dt``, linear or not, ``(n,)``, ``(n_inputs,)``
            to ``(n,)``; each in its own unit, dx/dt per second.
        state: where to linearise, ``(n,)``. command: the same, ``(n_inputs,)``.
        period: sampling period [s].
        output: output matrix C, ``(n_outputs, n)``.

    Raises:
        ModelError: ``ode`` is no such function, or has no finite derivative at the point; the
            period is not positive. ShapeError: the point or ``output`` does not fit ``ode``.
    """
    import casadi as ca  # noqa: PLC0415 - only what is built here needs it

    if not isinstance(ode, ca.Function):
        raise ModelError(f"ode must be a casadi.Function, got {type(ode).__name__}")
    if ode.n_in() != 2 or ode.n_out() != 1:
        raise ModelError(
            f"ode must map (x, u) to dx, but has {ode.n_in()} inputs and {ode.n_out()} outputs"
        )
    n = ode.size1_in(0)
    for i, name in enumerate(("ode's x", "ode's u")):
        if ode.size2_in(i) != 1:
            raise ShapeError(name, "(any, 1)", ode.size_in(i))
    if ode.size_out(0) != (n, 1):
        raise ShapeError("ode's dx", f"({n}, 1)", ode.size_out(0))
    point = vector("state", state, n), vector("command", command, ode.size1_in(1))
    A, B = _exact_hold(ode, *point, period)
    return LinearModel(A, B, matrix("output", output, columns=n), period)


def _exact_hold(
    ode: Expression, state: Array, command: Array, period: float
) -> tuple[Array, Array]:
    """Linearise ``ode`` at a point and discretise it exactly for a held input."""
    import casadi as ca  # noqa: PLC0415 - only what is built here needs it

    if not (np.isfinite(period) and period > 0):
        raise ModelError(f"period must be positive, got {period}")
    n, m = state.size, command.size
    x, u = ca.MX.sym("x", n), ca.MX.sym("u", m)
    rate = ode(x, u)
    generator = ca.Function("generator", [x, u], [ca.jacobian(rate, ca.vertcat(x, u))])
    slope = matrix("derivative of ode", generator(state, command).full())
    M = np.vstack([slope * period, np.zeros((m, n + m))])
    squarings = max(0, ceil(log2(max(np.abs(M).sum(axis=0).max(), 1e-9))) + 1)
    symbol = ca.MX.sym("M", n + m, n + m)
    E = ca.Function("expm", [symbol], [_exponential(symbol, squarings)])(M).full()
    return E[:n, :n], E[:n, n:]


def _exponential(M: Expression, squarings: int) -> Expression:
    """Write down exp(M): its series at ``M / 2^squarings``, of norm 1/2 at most, then squared."""
    import casadi as ca  # noqa: PLC0415 - only what is built here needs it

    one = ca.MX.eye(M.shape[0])
    small = M / 2.0**squarings
    result = one
    for k in range(_ORDER, 0, -1):
        result = one + small @ result / k
    for _ in range(squarings):
        result = result @ result
    return result


def _derivatives(pairs: list[tuple[Expression, Expression]]) -> tuple[Array, ...]:
    """Return the Jacobian of each expression by its symbol, where the symbols are zero.

    The symbols of the pairs must be all that the expressions hold.
    """
    import casadi as ca  # noqa: PLC0415 - only what is built here needs it

    symbols = list({by.name(): by for _, by in pairs}.values())
    jacobians = [ca.jacobian(of, by) for of, by in pairs]
    found = ca.Function("derivatives", symbols, jacobians).call([0.0] * len(symbols))
    return tuple(np.ascontiguousarray(M.full()) for M in found)
