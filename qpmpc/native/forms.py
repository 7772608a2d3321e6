"""What a backend says of itself where a compiled step can solve as it does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Protocol

from qpmpc.native.pack import Field
from qpmpc.native.toolchain import Library

if TYPE_CHECKING:
    from qpmpc.native.groups import Group
    from qpmpc.scaling import Scaling


@dataclass(frozen=True)
class Functions:
    """Functions of a library that is in this process."""

    addresses: tuple[int, ...]
    depends: tuple[str, ...]
    """Its name and version, part of what identifies a compiled step."""


NO_FUNCTIONS = Functions((), ())


class CompiledForm(Protocol):
    """A backend's way to solve as C text; `Backend.compiled` holds one."""

    @property
    def preamble(self) -> str:
        """C text before everything that depends on sizes."""
        ...

    @property
    def text(self) -> str:
        """C text of one kind of group: ``struct solver``, ``start``, ``forget``, ``solve``."""
        ...

    @property
    def heeds_rows(self) -> bool:
        """Whether an answer that fails the check against the rows is handed over."""
        ...

    def obstacle(self, scaling: Scaling) -> str | None:
        """Return why a QP that is scaled like this cannot be solved by it, or None."""
        ...

    def functions(self) -> Functions:
        """Return what it calls.

        Raises:
            CompiledStepError: the library is not there, or not one that is known.
        """
        ...

    def iterations(self, limit: int | None, size: int) -> int:
        """Return the limit of iterations, its own where none is given.

        Args:
            limit: as configured. size: variables and rows of the whole.
        """
        ...

    def sizes(self, group: Group) -> Mapping[str, int]:
        """Return the macros that its text wants for a group."""
        ...

    def constants(self, group: Group) -> Sequence[Field]:
        """Return what its text finds in ``struct constants``."""
        ...

    def verify(self, library: Library, functions: Functions) -> None:
        """Look whether the compiled text and the library that it calls understand each other.

        Raises:
            CompiledStepError: they do not.
        """
        ...


@cache
def c_text(name: str) -> str:
    """Return a C text of this package."""
    return resources.files("qpmpc.native").joinpath("csrc", name).read_text(encoding="utf-8")
