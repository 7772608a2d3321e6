"""A setpoint that another process sends while the run goes on, as a haptic device would.

Datagrams to a UDP port of this machine's own address, 127.0.0.1: nobody else can reach it. Each is
`LAYOUT`, little-endian: the four bytes ``pmS1``, a number that grows by one from datagram to
datagram (it may wrap), and the wished contact force on x, y, z [N] as doubles.

What comes from outside is not trusted. A datagram of another form, an old number, a value that is
no number or lies outside the bounds on the force is refused and counted. The setpoint follows at
a bounded rate, and where nothing comes it stays where it is.
"""

import socket
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from scenarios.config import LiveConfig
from scenarios.errors import ScenarioError
from scenarios.motion import Axis

Array = NDArray[np.float64]

LAYOUT = struct.Struct("<4sI3d")
"""Mark, number, force on x, y, z."""
MARK = b"pmS1"
ADDRESS = "127.0.0.1"
_AXES: tuple[Axis, ...] = ("x", "y", "z")
_MOST = 64
"""Datagrams that one cycle looks at; a flood must not cost it its time."""
_BUFFER = 4096
"""Asked of the system for waiting datagrams [bytes]: a short queue holds no old ones."""
_WRAP = 2**32


class Source(IntEnum):
    """What the setpoint of a cycle rests on."""

    PLANNED = 0
    """The scenario."""
    WAITING = 1
    """The start: nothing has come yet."""
    LIVE = 2
    """A datagram that is fresh."""
    STALE = 3
    """The last datagram, which is too old: the setpoint stays where it is."""


@dataclass
class Counts:
    """What came, and what was made of it."""

    received: int = 0
    """Datagrams that were looked at."""
    refused_form: int = 0
    """Of another length or mark."""
    refused_number: int = 0
    """Older than one that came before, or the same."""
    refused_value: int = 0
    """No number, or outside the bounds on the force."""
    limited_cycles: int = 0
    """Cycles in which the setpoint was farther from the wish than its rate allows."""
    stale_cycles: int = 0
    waiting_cycles: int = 0


def encode(number: int, force: Sequence[float]) -> bytes:
    """Return the datagram that wishes for ``force`` (x, y, z) [N]."""
    return LAYOUT.pack(MARK, number % _WRAP, *force)


class LiveSetpoint:
    """Wished contact force as it comes in; nothing is known ahead, so the preview is constant."""

    def __init__(
        self,
        config: LiveConfig,
        start: Array,
        bounds: tuple[Array, Array],
        axes: Sequence[Axis],
        *,
        cycles: int,
        horizon: int,
        period: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Open the port.

        Args:
            config: see there.
            start: setpoint until something comes, ``(3,)`` [N].
            bounds: least and largest force of each axis, ``(n_axes,)`` each [N]; may be infinite.
            axes: which axes, in the order of the columns; what is sent for others is not used.
            cycles, horizon, period: of the run; s.
            clock: what staleness is measured by [s].

        Raises:
            ScenarioError: the port cannot be had.
        """
        self.start = start
        self._index = [_AXES.index(axis) for axis in axes]
        self.force = np.zeros((cycles, len(axes)))
        """Setpoint of the cycles so far, ``(cycles, n_axes)`` [N]."""
        self.source = np.zeros(cycles, dtype=np.int8)
        """`Source` of each cycle so far, ``(cycles,)``."""
        self.counts = Counts()
        self._present = start[self._index].astype(np.float64)
        self._wish = self._present.copy()
        self._change, self._most = np.zeros(len(axes)), config.largest_rate * period
        self._low, self._high = bounds
        self._preview = np.zeros((horizon + 1, len(axes)))
        self._clock, self._patience = clock, config.stale_after
        self._number: int | None = None
        self._last = -np.inf
        self._data = bytearray(LAYOUT.size + 1)  # one more: what is longer shows
        self._socket = _bind(config.port)

    def preview(self, k: int) -> Array:
        """Look at what has come and return s(k), ``(N + 1, n_axes)`` [N]; valid until the next.

        Called once in each cycle, in their order.
        """
        now = self._clock()
        self._listen(now)
        if self._number is None:
            source = Source.WAITING
            self.counts.waiting_cycles += 1
        elif now - self._last > self._patience:
            source = Source.STALE
            self.counts.stale_cycles += 1
        else:
            source = Source.LIVE
            change = np.subtract(self._wish, self._present, out=self._change)
            if np.abs(change).max() > self._most:
                self.counts.limited_cycles += 1
                np.minimum(change, self._most, out=change)
                np.maximum(change, -self._most, out=change)
            self._present += change
        self.force[k] = self._present
        self.source[k] = source
        self._preview[:] = self._present
        return self._preview

    def summary(self) -> dict[str, int]:
        """Return the counts, for the summary of a run."""
        return asdict(self.counts)

    def close(self) -> None:
        """Give the port back."""
        self._socket.close()

    def _listen(self, now: float) -> None:
        for _ in range(_MOST):
            try:
                size = self._socket.recv_into(self._data)
            except BlockingIOError:
                return
            self.counts.received += 1
            self._take(size, now)

    def _take(self, size: int, now: float) -> None:
        """Take one datagram for the wish, or refuse it."""
        counts = self.counts
        if size != LAYOUT.size:
            counts.refused_form += 1
            return
        mark, number, *force = LAYOUT.unpack_from(self._data)
        if mark != MARK:
            counts.refused_form += 1
            return
        # After a silence any number begins anew: the sender may have been started again.
        fresh = now - self._last <= self._patience
        if fresh and not _follows(number, self._number):
            counts.refused_number += 1
            return
        wish = np.array([force[i] for i in self._index])
        if not ((wish >= self._low) & (wish <= self._high) & np.isfinite(wish)).all():
            counts.refused_value += 1
            return
        self._number, self._last = number, now
        self._wish = wish


def _follows(number: int, last: int | None) -> bool:
    """Whether a datagram is younger than the last one, the number's wrapping allowed for."""
    return last is None or 0 < (number - last) % _WRAP < _WRAP // 2


def _bind(port: int) -> socket.socket:
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        opened.setblocking(False)
        opened.bind((ADDRESS, port))
    except OSError as error:
        opened.close()
        raise ScenarioError(
            f"setpoint.live.port: cannot listen on {ADDRESS} port {port}: {error.strerror}"
        ) from None
    return opened
