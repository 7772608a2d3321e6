"""Progress on standard error, and a Ctrl-C that ends a run in order."""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn


class Reporter:
    """Shows how far a run is: a bar on a terminal, a line every tenth elsewhere."""

    def __init__(self, quiet: bool, *, own_thread: bool = True) -> None:
        """Prepare.

        Args:
            quiet: whether to show nothing.
            own_thread: whether the bar is kept moving by a thread of its own, which takes the
                interpreter from whoever measures time; without, it moves when it is told.
        """
        self._quiet, self._own_thread = quiet, own_thread
        self._console = Console(stderr=True)
        self._bar = Progress(
            TextColumn("{task.description:>14}"),
            BarColumn(),
            TextColumn("{task.percentage:>4.0f} %"),
            TimeRemainingColumn(),
            console=self._console,
            disable=quiet or not self._console.is_terminal,
            auto_refresh=own_thread,
        )
        self._tasks: dict[str, TaskID] = {}
        self._shown: dict[str, int] = {}

    def __enter__(self) -> "Reporter":
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Report ``done`` of ``total`` cycles of a stage."""
        if self._quiet:
            return
        if self._console.is_terminal:
            if stage not in self._tasks:
                self._tasks[stage] = self._bar.add_task(stage, total=total)
            self._bar.update(
                self._tasks[stage],
                completed=done if total > 1 else 1,
                refresh=not self._own_thread,
            )
            return
        tenth = 10 * done // total
        if tenth != self._shown.get(stage):
            self._shown[stage] = tenth
            text = f"{stage}: {10 * tenth} %" if total > 1 else f"{stage} ..."
            print(text, file=sys.stderr, flush=True)


class Interrupt:
    """Remembers a Ctrl-C; the loop asks for it once per cycle."""

    def __init__(self) -> None:
        self.pressed = False

    def __call__(self) -> bool:
        """Whether to stop."""
        return self.pressed


@contextmanager
def ctrl_c() -> Iterator[Interrupt]:
    """Turn the first Ctrl-C into a request to stop; the second one interrupts as usual."""
    interrupt = Interrupt()

    def handle(_signal: int, _frame: FrameType | None) -> None:
        if interrupt.pressed:
            raise KeyboardInterrupt
        interrupt.pressed = True

    before = signal.signal(signal.SIGINT, handle)
    try:
        yield interrupt
    finally:
        signal.signal(signal.SIGINT, before)
