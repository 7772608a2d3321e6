"""The closed form in C: one product."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from qpmpc.native.forms import NO_FUNCTIONS, Functions, c_text
from qpmpc.native.pack import Field, columns
from qpmpc.native.toolchain import Library

if TYPE_CHECKING:
    from qpmpc.native.groups import Group
    from qpmpc.scaling import Scaling


class ClosedForm:
    """``x = -P^-1 q``, a `CompiledForm`."""

    preamble = ""
    heeds_rows = False

    @property
    def text(self) -> str:
        """See `CompiledForm`."""
        return c_text("closed.c")

    def obstacle(self, scaling: Scaling) -> str | None:  # noqa: ARG002 - there is none
        """See `CompiledForm`."""
        return None

    def functions(self) -> Functions:
        """Return none."""
        return NO_FUNCTIONS

    def iterations(self, limit: int | None, size: int) -> int:  # noqa: ARG002 - takes none
        """Return 0."""
        return 0

    def sizes(self, group: Group) -> Mapping[str, int]:  # noqa: ARG002
        """Return none."""
        return {}

    def constants(self, group: Group) -> Sequence[Field]:
        """Return the gain from the scaled gradient to the decision."""
        return [columns("closed", -group.back @ np.linalg.inv(group.scaled_hessian))]

    def verify(self, library: Library, functions: Functions) -> None:
        """Nothing is called."""
