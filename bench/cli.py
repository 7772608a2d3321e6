"""The entry point: ``pulsempc`` and ``python -m bench``."""

import os
import sys
from collections.abc import Sequence

from bench.ownership import complaint

INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and leave with its exit code.

    0: done; 1: the simulation failed on the way, or the protection tripped; 2: bad input;
    130: Ctrl-C.
    """
    problem = complaint()
    if problem is not None:
        print(f"pulsempc: {problem}", file=sys.stderr)
        sys.exit(2)
    try:
        # Where it names a library that is not there MuJoCo cannot even be imported; what draws a
        # film looks for one itself.
        os.environ.pop("MUJOCO_GL", None)
        # Only now: somebody else's package of the same name would break this import.
        from bench.dispatch import dispatch  # noqa: PLC0415

        code = dispatch(list(sys.argv[1:] if arguments is None else arguments))
    except KeyboardInterrupt:
        print("pulsempc: interrupted; nothing was written", file=sys.stderr)
        code = INTERRUPTED
    sys.exit(code)
