"""The page of a running experiment: what it shows, and how commands get from it to the other."""

import html
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from bench.live.controls import Controls
from bench.live.plots import Plots
from bench.live.process import Remote
from bench.live.scenery import Scenery
from qpmpc.fallback import Source
from qpmpc.status import Status
from scenarios.approach import ContactState
from scenarios.config import Scenario
from scenarios.livecell.commands import Command, Event, Kind
from scenarios.livecell.ring import COLUMNS, HEAD, Ring

_POSES, _PLOTS, _TISSUE = 0.04, 0.1, 0.2
"""Time between two pictures of arms, plots, tissue [s]."""
_SOURCES, _STATUSES = tuple(Source), tuple(Status)
_WORDS = 6
"""Messages that are kept on the page."""


class Page:
    """Everything in the page."""

    def __init__(self, server: Any, scenario: Scenario, remote: Remote) -> None:
        """Lay it out on a server's empty page."""
        self._server, self._remote = server, remote
        self._asked: deque[Command] = deque()
        gui = server.gui
        gui.configure_theme(
            control_layout="fixed", control_width="large", show_logo=False,
            show_share_button=False, dark_mode=True,
        )  # fmt: skip
        gui.set_panel_label(f"pulsempc: {scenario.name}")
        self._status = gui.add_html("")
        self._plots = Plots(gui, scenario.cell.period)
        # Widgets call from threads of their own; the pipe belongs to one.
        self._controls = Controls(gui, scenario, self._asked.append)
        self._scenery = Scenery(server, scenario)
        self._scenario = scenario
        self._said: deque[Event] = deque(maxlen=_WORDS)

    def show(self, until: Callable[[], bool]) -> None:
        """Keep the page up to date until it is enough.

        Raises:
            ExperimentDiedError: there is nothing more to show.
        """
        plots, tissue = _every(_PLOTS), _every(_TISSUE)
        while not until():
            while self._asked:
                self._remote.send(self._asked.popleft())
            for event, scenario in self._remote.events():
                self._hear(event, scenario)
            ring = self._remote.ring
            rows = ring.last(1)
            if self._server.get_clients() and len(rows):
                with self._server.atomic():
                    self._draw(ring, rows[0], tissue=next(tissue))
                    if next(plots):
                        self._plots.show(ring)
                        self._status.content = self._text(ring)
                        self._controls.tell(
                            paused=ring.told("paused") > 0, recording=ring.told("recording") > 0
                        )
            time.sleep(_POSES)

    def _hear(self, event: Event, scenario: Scenario) -> None:
        self._said.append(event)
        self._scenario = scenario
        if event.kind is not Kind.TOLD:
            self._controls.show(scenario)
            for client in self._server.get_clients().values():
                client.add_notification(
                    str(event.kind).capitalize(), html.escape(event.text), color="red",
                    auto_close_seconds=6.0,
                )  # fmt: skip

    def _draw(self, ring: Ring, row: Any, *, tissue: bool) -> None:
        joints = int(ring.told("joints"))
        self._scenery.pose(
            ring.joint_angle[:joints].copy(), bool(ring.told("touching")),
            row[COLUMNS["force"]], tissue=tissue,
        )  # fmt: skip

    def _text(self, ring: Ring) -> str:
        rows = ring.last(1000)
        last = rows[-1]
        error = np.abs(rows[:, COLUMNS["force"]] - rows[:, COLUMNS["setpoint"]])
        worst = np.nanmax(error) if np.isfinite(error).any() else np.nan
        source = _SOURCES[int(last[COLUMNS["source"]][0])]
        status = _STATUSES[int(last[COLUMNS["status"]][0])]
        contact = ContactState(int(last[COLUMNS["contact"]][0])).name.lower()
        share = float(last[COLUMNS["share"]][0])
        s = self._scenario
        coming = f"; another is coming, {100 * share:.0f} %" if share else ""
        state = "paused" if ring.told("paused") else f"{ring.told('speed'):.2f} x real time"
        lines = [
            f"<b>{ring.head[HEAD['time']]:.2f} s</b>, {state}, "
            f"{ring.told('lost'):.1f} s let go, {contact}"
            + (", <b>tripped</b>" if ring.told("tripped") else ""),
            f"{html.escape(s.controller.kind)} / {html.escape(s.backend)}{coming}; "
            f"command from {source} ({status})",
            "force {:.2f}, {:.2f}, {:.2f} N".format(*last[COLUMNS["measured"]]),
            f"largest force error of the last second {worst:.2f} N, "
            f"slowest cycle {1e6 * rows[:, COLUMNS['cycle_time']].max():.0f} us",
        ]
        lines += [
            f"{event.time:.2f} s: {'' if event.kind is Kind.TOLD else f'<b>{event.kind}</b>: '}"
            f"{html.escape(event.text[:200])}"
            for event in reversed(self._said)
        ]
        return f'<div id="pulsempc-status" style="padding:0.4em 0.8em">{"<br>".join(lines)}</div>'


def _every(period: float) -> Iterator[bool]:
    """Yield whether it is time again."""
    due = time.monotonic()
    while True:
        now = time.monotonic()
        if now < due:
            yield False
        else:
            due = now + period
            yield True
