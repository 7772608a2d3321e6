"""Why something could not be compiled: each error carries its data."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from qpmpc.errors import QpmpcError


class CompilerUnavailableError(QpmpcError):
    """No C compiler can be run here.

    Attributes:
        tried: the commands that were looked for.
    """

    def __init__(self, tried: Iterable[str], why: str = "none is here") -> None:
        self.tried = tuple(tried)
        super().__init__(
            f"no C compiler: looked for {', '.join(self.tried)}, {why}; "
            "install one or name it in the environment variable CC"
        )


class CompilationError(QpmpcError):
    """The C compiler refused a generated text.

    Attributes:
        compiler: its command.
        output: all that it said.
    """

    def __init__(self, compiler: str, output: str) -> None:
        self.compiler, self.output = compiler, output
        lines = [line.strip() for line in output.splitlines() if line.strip()]
        first = next((line for line in lines if "error" in line), lines[0] if lines else "no word")
        super().__init__(f"{compiler} failed: {first}")


class CacheError(QpmpcError):
    """The folder of compiled libraries cannot be used, or must not be.

    Attributes:
        path: of the folder.
    """

    def __init__(self, path: Path | str, message: str) -> None:
        self.path = Path(path)
        super().__init__(f"cache {path}: {message}")


class CompiledStepError(QpmpcError):
    """A controller has no compiled step, and one was asked for.

    Attributes:
        reason: why.
    """

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(f"no compiled step: {reason}")
