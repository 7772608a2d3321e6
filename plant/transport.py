"""What carries commands to the motors: a delay of whole periods, and now and then more."""

from collections import deque
from typing import Generic, TypeVar

import numpy as np

T = TypeVar("T")
_BLOCK = 1024
"""Random numbers that are drawn at once."""


class Transport(Generic[T]):
    """A line that takes in one item a period, and gives out the one that acts.

    Each item takes ``delay`` periods and a random number n of more, P(n >= i) = jitter^i: as on a
    bus that sends again, a period later, what was lost. None overtakes another: where one is held
    up, those behind it arrive with it at the earliest. Of those that arrive in the same period
    the last one counts, the others are lost; where none arrives, the one before goes on.
    """

    def __init__(self, delay: int, jitter: float, seed: np.random.SeedSequence) -> None:
        """Prepare.

        Args:
            delay: least number of periods that an item takes.
            jitter: probability of one period more, in [0, 1).
            seed: of the random numbers; without jitter none are drawn.
        """
        self._delay, self._jitter = delay, jitter
        self._generator = np.random.default_rng(seed)
        self._line: deque[tuple[int, T]] = deque()
        self._extra: list[int] = []

    def begin(self, acting: T) -> None:
        """Start anew, with an item that acts until another arrives."""
        self._line.clear()
        self._acting = acting

    def carry(self, period: int, item: T) -> T:
        """Take in the item of a period, return what acts in it.

        Periods are counted from 0, one call each.
        """
        extra = 0
        if self._jitter:
            if not self._extra:
                drawn = self._generator.geometric(1.0 - self._jitter, _BLOCK) - 1
                self._extra = drawn[::-1].tolist()
            extra = self._extra.pop()
        self._line.append((period + self._delay + extra, item))
        while self._line and self._line[0][0] <= period:
            self._acting = self._line.popleft()[1]
        return self._acting
