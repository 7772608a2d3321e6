"""Errors of the controller library: one base class, each error carries its data."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class QpmpcError(Exception):
    """Base of all errors raised by ``qpmpc``; its text is one line fit to be shown to a user."""


class ModelError(QpmpcError):
    """A model, a weight or an argument does not fit the others."""


class ShapeError(ModelError):
    """An array has the wrong shape.

    Attributes:
        name: the argument as the caller knows it.
        expected: what its shape must be, in words or numbers.
        actual: the shape that came.
    """

    def __init__(self, name: str, expected: str, actual: tuple[int, ...]) -> None:
        self.name, self.expected, self.actual = name, expected, actual
        super().__init__(f"{name} must have shape {expected}, got {actual}")


class BoundsError(QpmpcError):
    """Bounds that contradict each other or the model.

    Attributes:
        bound: name of the bound.
    """

    def __init__(self, bound: str, message: str) -> None:
        self.bound = bound
        super().__init__(f"bound '{bound}': {message}")


class ObserverError(QpmpcError):
    """No steady-state observer exists for the model and the noise given."""


class UnknownNameError(QpmpcError):
    """A name that is not among the valid ones.

    Attributes:
        kind: what was looked for ("backend", ...).
        name: what was given.
        valid: the names that would have been right.
    """

    def __init__(self, kind: str, name: str, valid: Iterable[str]) -> None:
        self.kind, self.name, self.valid = kind, name, tuple(valid)
        super().__init__(f"unknown {kind} '{name}'{suggest(name, self.valid)}")


class BackendUnavailableError(QpmpcError):
    """A backend whose solver cannot be imported.

    Attributes:
        backend: name of the backend.
        install: what installs it.
    """

    def __init__(self, backend: str, install: str) -> None:
        self.backend, self.install = backend, install
        super().__init__(f"backend '{backend}' needs a package that is not here: {install}")


class BackendSetupError(QpmpcError):
    """A solver refused the constant part of the QP.

    Attributes:
        backend: name of the backend.
    """

    def __init__(self, backend: str, message: str) -> None:
        self.backend = backend
        super().__init__(f"backend '{backend}': {message}")


def suggest(name: str, valid: Iterable[str]) -> str:
    """Return the tail of an error line: the nearest valid name and all of them."""
    names = list(valid)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    hint = f", did you mean '{near[0]}'?" if near else ""
    return f"{hint} (valid: {', '.join(names)})"
