"""Errors of the motion: each carries what it is about, so that a caller need not read its text."""

from scenarios.errors import ScenarioError


class UnreachableForceError(ScenarioError):
    """The pulses cannot give the force targets of an axis.

    Attributes: ``axis``; ``ratio``, peak to peak over RMS asked for [-]; ``lowest`` and ``highest``
    ratio within reach [-].
    """

    def __init__(self, axis: str, ratio: float, lowest: float, highest: float) -> None:
        self.axis = axis
        self.ratio = ratio
        self.lowest = lowest
        self.highest = highest
        super().__init__(
            f"motion.force_peak_to_peak is {ratio:.2f} times motion.force_rms on axis {axis}; "
            f"with these beats and this breath the ratio must lie in {lowest:.2f} to {highest:.2f}"
        )


class MotionKeyError(ScenarioError):
    """Keys of the motion table that another key leaves without effect.

    Attributes: ``keys``, those without effect; ``source``, the key that overrides them.
    """

    def __init__(self, keys: tuple[str, ...], source: str) -> None:
        self.keys = keys
        self.source = source
        names = ", ".join(f"motion.{key}" for key in keys)
        super().__init__(f"{names}: no effect beside motion.{source}; remove one or the other")
