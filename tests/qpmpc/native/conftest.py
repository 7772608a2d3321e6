"""Here steps are compiled, which the other tests of the package leave out: quickly, not fast."""

from __future__ import annotations

import pytest

from qpmpc.native import toolchain


@pytest.fixture(autouse=True)
def compiled_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """In place of the fixture of the folder above."""
    monkeypatch.setattr(toolchain, "OPTIMISED", ("-std=gnu11", "-O1", "-fno-math-errno"))
