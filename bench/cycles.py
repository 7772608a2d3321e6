"""What is kept of every cycle of a timed run, preallocated and touched ahead."""

import numpy as np
from numpy.typing import NDArray

from qpmpc import Source, Status

Times = NDArray[np.int64]
Codes = NDArray[np.int8]
STATUSES, SOURCES = tuple(Status), tuple(Source)
NONE = -1
"""Code, or time, of what a cycle does not have."""


class Cycles:
    """One row a cycle; times in ns, `NONE` where there is none. Columns are views up to `count`."""

    def __init__(self, room: int, period: int, deadline: int) -> None:
        """Make room for ``room`` cycles.

        Args:
            room: how many at most.
            period, deadline: of the cycles [ns].
        """
        self.period, self.deadline = period, deadline
        self.count = 0
        # Filled, not only reserved: the first write to a page must not happen in the loop.
        self._times = np.full((7, room), NONE, dtype=np.int64)
        self._codes = np.full((2, room), NONE, dtype=np.int8)
        self._behind = np.full(room, 0, dtype=np.bool_)
        self._overran = np.full(room, 0, dtype=np.bool_)

    def note(
        self,
        *,
        late: int,
        timer: int,
        begin: int,
        done: int,
        settled: int,
        ended: int,
        solve: int,
        status: int,
        source: int,
        behind: bool,
        put_off: int,
    ) -> None:
        """Keep a cycle.

        Args:
            late: how long after its release it began.
            timer: how much too late the sleep before it ended, `NONE` where there was none.
            begin, done, settled, ended: instants of the clock: it began, the command was handed
                over, the controller was ready for the next cycle, the plant was.
            solve: what the backend took.
            status, source: codes in `STATUSES` and `SOURCES`.
            behind: whether the plant of the cycle before delayed the start of this one.
            put_off: by how much its plant put off the releases to come.
        """
        k, times = self.count, self._times
        release = begin - late
        following = release + self.period
        times[0, k] = late
        times[1, k] = timer
        times[2, k] = settled - begin
        times[3, k] = done - release
        times[4, k] = ended - settled
        times[5, k] = solve
        self._codes[0, k] = status
        self._codes[1, k] = source
        self._behind[k] = behind
        times[6, k] = put_off
        self._overran[k] = settled <= following < ended
        self.count = k + 1

    @property
    def wake(self) -> Times:
        """From the intended release to the first instruction."""
        return self._times[0, : self.count]

    @property
    def timer(self) -> Times:
        """How much later than asked the sleeps ended; cycles that did not sleep are left out."""
        return _known(self._times[1, : self.count])

    @property
    def compute(self) -> Times:
        """The controller: from the first instruction to being ready for the next cycle."""
        return self._times[2, : self.count]

    @property
    def response(self) -> Times:
        """From the intended release to the command being handed over."""
        return self._times[3, : self.count]

    @property
    def plant(self) -> Times:
        """Simulation of the plant until its next measurement is there."""
        return self._times[4, : self.count]

    @property
    def solve(self) -> Times:
        """The backend, building its problem included; cycles without a solve are left out."""
        return _known(self._times[5, : self.count])

    @property
    def status(self) -> Codes:
        """Codes in `STATUSES`."""
        return self._codes[0, : self.count]

    @property
    def source(self) -> Codes:
        """Codes in `SOURCES`."""
        return self._codes[1, : self.count]

    @property
    def missed(self) -> NDArray[np.bool_]:
        """Whether the response came after the deadline."""
        return self.response > self.deadline

    @property
    def overran(self) -> NDArray[np.bool_]:
        """Whether the plant ended after the next release, when the controller had been done."""
        return self._overran[: self.count]

    @property
    def behind(self) -> NDArray[np.bool_]:
        """Whether a plant that took more than it does ordinarily delayed this cycle's start."""
        return self._behind[: self.count]

    @property
    def put_off(self) -> Times:
        """By how much the plant put off the releases to come, as it takes time to simulate."""
        return self._times[6, : self.count]


def _known(times: Times) -> Times:
    known: Times = times[times != NONE]
    return known


def longest_run(flags: NDArray[np.bool_]) -> int:
    """Return the length of the longest unbroken row of true flags."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(np.int8)))
    return int((edges[1::2] - edges[::2]).max(initial=0))
