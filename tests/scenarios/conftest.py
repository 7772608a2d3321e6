"""What the tests of the experiments share: short runs on the real cell, scenario files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from plant.cell import heart_programme
from scenarios import Experiment, Log, Scenario, load_scenario, run_experiment, summarise
from scenarios.motion import load_motion

# Half of what a run of 0.1 s costs, and the same for most of them.
_MOTION, _PROGRAMME = lru_cache(4)(load_motion), lru_cache(4)(heart_programme)


@dataclass(frozen=True, eq=False)
class Run:
    """A finished experiment and what is read from it most."""

    experiment: Experiment
    scenario: Scenario
    log: Log
    summary: dict[str, Any]


def _simulate(name: str, *settings: str, still: bool = True, **top: Any) -> Run:
    """Run a scenario to its end.

    Args:
        name, settings, top: as for `load_scenario`.
        still: whether to simulate the run with the brakes closed too; zeros stand for it if not.
    """
    scenario = load_scenario(name, top=top, settings=settings)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("scenarios.experiment.load_motion", _MOTION)
        patch.setattr("scenarios.experiment.heart_programme", _PROGRAMME)
        experiment = run_experiment(
            scenario,
            report=lambda *_: None,
            stop=lambda: False,
            held=None if still else np.zeros((scenario.cycles, 3)),
        )
    assert experiment.stopped is None
    return Run(experiment, scenario, experiment.log, summarise(experiment))


@pytest.fixture(scope="session")
def simulate() -> Callable[..., Run]:
    """Run a scenario with settings to its end, with or without the run with closed brakes."""
    return _simulate


@pytest.fixture
def write(tmp_path):
    """Write a scenario file, return its path as text."""

    def put(text: str | bytes, name: str = "mine.toml") -> str:
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return str(path)

    return put
