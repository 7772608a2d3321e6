"""``pulsempc report``: one HTML file about one or several results."""

import sys
import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from bench.report import write_report
from bench.verbs._asked import now

_arg = tyro.conf.arg


@dataclass(frozen=True)
class Report:
    """Make one HTML file of one result, or of several side by side.

    For example, `pulsempc report runs/paper-20260101-120000 --open`, or
    `pulsempc report runs/before runs/after --out change.html`.
    """

    folders: Annotated[tyro.conf.Positional[tuple[Path, ...]], _arg(metavar="RUN...")]
    """Folders that run, compare, bench latency or bench deadline wrote."""
    out: Annotated[Path | None, _arg(metavar="FILE.html")] = None
    """The file; report.html in the folder if there is one, runs/report-<time>.html for several."""
    open: tyro.conf.FlagCreatePairsOff[bool] = False
    """Show it in the browser."""

    def run(self) -> int:
        """Read, write, tell where; return the exit code."""
        path = self.out
        if path is None:
            one = len(self.folders) == 1
            path = self.folders[0] / "report.html" if one else Path("runs") / f"report-{now()}.html"
        write_report(self.folders, path)
        print(f"report: {path}")
        if self.open and not webbrowser.open(path.resolve().as_uri()):
            print("pulsempc: no browser to open it with", file=sys.stderr)
        return 0
