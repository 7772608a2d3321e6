"""``pulsempc scenarios``, ``pulsempc controllers`` and ``pulsempc backends``: what there is."""

from dataclasses import dataclass

from rich.console import Console

from bench.table import backend_table, controller_table, scenario_table
from qpmpc.backends import available
from qpmpc.kinds import controllers
from scenarios import load_scenario, shipped


@dataclass(frozen=True)
class Scenarios:
    """List the scenarios that are shipped.

    For example, `pulsempc scenarios`.
    """

    def run(self) -> int:
        """Print the table; return the exit code."""
        Console().print(scenario_table(load_scenario(name) for name in shipped()))
        return 0


@dataclass(frozen=True)
class Controllers:
    """List the controllers: the predictive one and its rivals, and where each comes from.

    For example, `pulsempc controllers`.
    """

    def run(self) -> int:
        """Print the table; return the exit code."""
        Console().print(controller_table(controllers()))
        return 0


@dataclass(frozen=True)
class Backends:
    """List the solver backends: which are installed, which version, what installs the others.

    For example, `pulsempc backends`.
    """

    def run(self) -> int:
        """Print the table; return the exit code."""
        Console().print(backend_table(available()))
        return 0
