"""Who turns model and weights into matrices: numpy here, or another that gives the same ones."""

from __future__ import annotations

from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike

from qpmpc.arrays import Array
from qpmpc.contact import ContactModel, contact_model
from qpmpc.models import LinearModel
from qpmpc.prediction import Prediction, absolute_prediction, prediction

Decision = Literal["increment", "absolute"]


class Construction(Protocol):
    """Contact model, prediction and cost, each from the same arguments to the same matrices."""

    def contact(
        self,
        stiffness: float,
        velocity_damping: float,
        period: float,
        *,
        lag: float,
        separate_tool: bool,
    ) -> ContactModel:
        """Build the discrete model of one axis, as `qpmpc.contact.contact_model` does."""
        ...

    def prediction(
        self,
        model: LinearModel,
        horizon: int,
        moves: int,
        output: ArrayLike | None,
        decision: Decision,
    ) -> Prediction:
        """Build Psi, Upsilon, Theta, as `prediction` and `absolute_prediction` do."""
        ...

    def cost(self, Theta: Array, delta: Array, lam: Array) -> tuple[Array, Array]:
        """Return P and the map from the free response's error to q.

        Args:
            Theta: response to the decision, ``(n_rows, n_z)``.
            delta: weight of each row, ``(n_rows,)``. lam: weight of each decision, ``(n_z,)``.

        Returns:
            ``P = 2 (Theta' Q Theta + R)``, ``(n_z, n_z)``, symmetric, and ``-2 Theta' Q``,
            ``(n_z, n_rows)``.
        """
        ...


class NumpyConstruction:
    """The matrices of `qpmpc.contact` and `qpmpc.prediction`."""

    def contact(
        self,
        stiffness: float,
        velocity_damping: float,
        period: float,
        *,
        lag: float,
        separate_tool: bool,
    ) -> ContactModel:
        """See `Construction`."""
        return contact_model(
            stiffness, velocity_damping, period, lag=lag, separate_tool=separate_tool
        )

    def prediction(
        self,
        model: LinearModel,
        horizon: int,
        moves: int,
        output: ArrayLike | None,
        decision: Decision,
    ) -> Prediction:
        """See `Construction`."""
        build = prediction if decision == "increment" else absolute_prediction
        return build(model, horizon, moves, output)

    def cost(self, Theta: Array, delta: Array, lam: Array) -> tuple[Array, Array]:
        """See `Construction`."""
        weighted = delta[:, None] * Theta
        P = 2.0 * (Theta.T @ weighted + np.diag(lam))
        return (P + P.T) / 2, -2.0 * np.ascontiguousarray(weighted.T)


NUMPY: Construction = NumpyConstruction()
