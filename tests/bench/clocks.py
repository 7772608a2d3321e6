"""A clock that the test holds: nothing takes time but what says so."""


class FakeClock:
    """Time [ns] that stands still, passes by `spend`, and is slept through exactly, or too long."""

    sleeps_by = "the test"

    def __init__(self, start: int = 1_000_000, *, tick: int = 0, oversleep: int = 0) -> None:
        self.time, self.tick, self.oversleep = start, tick, oversleep
        self.slept: list[int] = []

    def now(self) -> int:
        self.time += self.tick
        return self.time

    def sleep_until(self, instant: int) -> None:
        self.slept.append(instant)
        self.time = max(self.time, instant + self.oversleep)

    def spend(self, time: int) -> None:
        self.time += time
