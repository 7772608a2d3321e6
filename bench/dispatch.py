"""From arguments to a verb, and from errors to one line and an exit code."""

import contextlib
import io
import sys
from typing import NoReturn

import tyro

from bench import commands
from plant.errors import PlantError
from qpmpc.errors import QpmpcError
from scenarios.errors import ScenarioError

BAD_INPUT = 2


def dispatch(arguments: list[str]) -> int:
    """Run the verb that the arguments name; return the exit code, or leave with it."""
    command = _parse(arguments)
    try:
        return command.run()
    except (QpmpcError, PlantError, ScenarioError) as error:
        _fail(str(error))


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
