"""Here steps are compiled, which the other tests of the package leave out: quickly, not fast."""

from __future__ import annotations

import pytest

from qpmpc.native import toolchain


@pytest.fixture(autouse=True)
def with_compiler(monkeypatch, the_usual_compiler):
    if the_usual_compiler is None:
        monkeypatch.delenv("CC", raising=False)
    else:
        monkeypatch.setenv("CC", the_usual_compiler)
    monkeypatch.setattr(toolchain, "OPTIMISED", ("-std=gnu11", "-O1", "-fno-math-errno"))
