"""What a report refuses."""

from pathlib import Path

from scenarios import ScenarioError


class ReportError(ScenarioError):
    """A folder that no report can be made of, or a place that it cannot be written to.

    Attributes: ``path`` of the folder or file; ``reason``.
    """

    def __init__(self, path: Path, reason: str) -> None:
        self.path = path
        self.reason = reason
        super().__init__(f"{path}: {reason}")
