"""``pulsempc live``: the running experiment in the browser."""

import sys
import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from bench.cli import INTERRUPTED
from bench.progress import ctrl_c
from bench.verbs._asked import Asked, load
from scenarios.errors import ScenarioError

_arg = tyro.conf.arg


@dataclass(frozen=True, kw_only=True)
class Live(Asked):
    """Run a scenario without an end and show it in the browser, to be changed while it runs.

    Needs viser: pip install 'pulsempc[live]'. Ctrl-C ends it.
    """

    controller: Annotated[str | None, _arg(metavar="NAME")] = None
    """Which controller to begin with, see `pulsempc controllers`."""
    backend: Annotated[str | None, _arg(metavar="NAME")] = None
    """Solver to begin with, see `pulsempc backends`."""
    host: Annotated[str, _arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address to listen on. Whoever reaches it can steer the experiment."""
    port: Annotated[int, _arg(metavar="N")] = 0
    """Port to listen on; 0: any that is free."""
    open: tyro.conf.FlagCreatePairsOff[bool] = False
    """Open the page in the browser."""
    setpoint: Annotated[Path | None, _arg(metavar="FILE.csv")] = None
    """A recorded wish, of which the first row counts: columns t, x, y, z [s, N]."""
    duration: Annotated[float | None, _arg(metavar="S")] = None
    """Length of the motion, which then begins anew [s]."""
    out: Annotated[Path, _arg(metavar="DIR")] = Path("runs")
    """Where folders of recordings are made."""

    def run(self) -> int:
        """Show until Ctrl-C; return the exit code."""
        try:
            import viser  # noqa: F401, PLC0415
        except ImportError:
            raise ScenarioError(
                "live: viser is not installed; pip install 'pulsempc[live]'"
            ) from None
        # Only now: they import it.
        from bench.live.page import Page  # noqa: PLC0415
        from bench.live.process import Remote  # noqa: PLC0415
        from bench.live.server import free_port, listen  # noqa: PLC0415

        scenario = load(self, backend=self.backend, controller=self.controller)
        port = free_port(self.host, self.port)
        with (
            ctrl_c() as interrupt,
            Remote(scenario, self.out) as remote,
            listen(self.host, port) as server,
        ):
            page = Page(server, scenario, remote)
            url = f"http://{self.host}:{port}"
            print(f"pulsempc: {scenario.name} at {url}; Ctrl-C ends it", file=sys.stderr)
            if self.open:
                webbrowser.open(url)
            page.show(until=interrupt)
        return INTERRUPTED
