"""What is compiled on the user's machine: C text to a loaded library, cached by content."""

from qpmpc.native.errors import (
    CacheError,
    CompilationError,
    CompiledStepError,
    CompilerUnavailableError,
)
from qpmpc.native.toolchain import OPTIMISED, Library, compile_library

__all__ = [
    "OPTIMISED",
    "CacheError",
    "CompilationError",
    "CompiledStepError",
    "CompilerUnavailableError",
    "Library",
    "compile_library",
]
