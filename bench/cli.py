"""The command line: ``pulsempc run``, ``pulsempc scenarios``, ``pulsempc backends``."""

import contextlib
import io
import sys
from collections.abc import Sequence
from typing import NoReturn

import tyro

from bench import commands, ownership
from plant.errors import PlantError
from qpmpc.errors import QpmpcError
from scenarios.errors import ScenarioError

BAD_INPUT = 2


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and leave with its exit code.

    0: done; 1: the simulation failed on the way; 2: bad input; 130: Ctrl-C.
    """
    foreign = ownership.foreign_owners()
    if foreign:
        claims = "; ".join(f"'{root}' by {', '.join(names)}" for root, names in foreign.items())
        others = " ".join(sorted({name for names in foreign.values() for name in names}))
        _fail(
            f"import packages of pulsempc are claimed by other distributions: {claims}. "
            f"pip uninstall {others} and reinstall pulsempc, or give it an environment of its own"
        )
    command = _parse(list(sys.argv[1:] if arguments is None else arguments))
    try:
        code = command.run()
    except (QpmpcError, PlantError, ScenarioError) as error:
        _fail(str(error))
    except KeyboardInterrupt:
        print("pulsempc: interrupted; nothing was written", file=sys.stderr)
        code = commands.INTERRUPTED
    sys.exit(code)


def _parse(arguments: list[str]) -> commands.Command:
    """Turn arguments into a command; what cannot be is told in one line."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            return tyro.cli(
                commands.Command,
                prog="pulsempc",
                description="Predictive force control of a robot on a beating heart, simulated.",
                args=_one_setting_each(arguments),
                config=(tyro.conf.OmitSubcommandPrefixes,),
            )
    except SystemExit as exit_:
        if exit_.code == BAD_INPUT:
            _fail(f"{_first_sentence(said.getvalue())}; see pulsempc --help")
        sys.stderr.write(said.getvalue())
        raise


def _first_sentence(box: str) -> str:
    """Take the message out of the frame that the parser draws around it."""
    lines = [line.strip("╭╮╰╯│─ ").strip() for line in box.splitlines()[1:]]
    message: list[str] = []
    for line in lines:
        if (not line and message) or line.startswith("Got errors"):
            break
        message.append(line)
    return (
        " ".join(part for part in message if part).rstrip(".") or "the arguments are not understood"
    )


def _one_setting_each(arguments: list[str]) -> list[str]:
    """Let ``--set a=1 b=2`` mean ``--set a=1 --set b=2``."""
    result: list[str] = []
    collecting = False
    for argument in arguments:
        if collecting and not argument.startswith("-") and "=" in argument:
            if result[-1] != "--set":
                result.append("--set")
        else:
            collecting = argument == "--set"
        result.append(argument)
    return result


def _fail(message: str) -> NoReturn:
    print(f"pulsempc: {message}", file=sys.stderr)
    sys.exit(BAD_INPUT)
