"""Facts of the machine are read, not believed."""

from __future__ import annotations

import gc
import json
import os
from pathlib import Path

import numpy as np
import pytest

from bench import machine as machine_module
from bench.machine import NOT_ASKED, machine, measures, usage


def test_facts_are_plain_data_and_those_of_this_machine() -> None:
    told = machine()
    assert json.loads(json.dumps(told, allow_nan=False)) == told
    assert told["kernel"] == os.uname().release
    assert told["cores"] == os.cpu_count()
    assert told["versions"]["numpy"] == np.__version__
    assert len(told["load_average"]) == 3
    assert told["governor"]


def test_a_measure_is_in_force_whoever_took_it() -> None:
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(before)})
        affinity = measures({"affinity": "a reason that is not one"})["affinity"]
        assert affinity == {"in_force": True, "value": [min(before)], "reason": None}
    finally:
        os.sched_setaffinity(0, before)


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="there is one core only")
def test_a_measure_that_is_not_in_force_has_a_reason() -> None:
    assert measures()["affinity"]["reason"] == NOT_ASKED
    told = measures({"affinity": "refused"})["affinity"]
    assert (told["in_force"], told["reason"]) == (False, "refused")
    assert told["value"] == sorted(os.sched_getaffinity(0))


def test_collection_is_stopped_only_if_the_heap_is_frozen_too() -> None:
    enabled = gc.isenabled()
    try:
        gc.disable()
        assert not measures()["garbage_collection"]["in_force"]
        gc.freeze()
        assert measures()["garbage_collection"]["in_force"]
        gc.enable()
        assert not measures()["garbage_collection"]["in_force"]
    finally:
        gc.unfreeze()
        (gc.enable if enabled else gc.disable)()


def test_usage_counts_the_pages_that_are_touched() -> None:
    before = usage()
    room = np.empty(64 * 2**20, dtype=np.uint8)
    room[::4096] = 1
    after = usage()
    assert after["minor_faults"] > before["minor_faults"]
    assert all(after[name] >= before[name] for name in before)


def test_a_system_that_tells_nothing_is_no_error(monkeypatch, tmp_path: Path) -> None:
    """Neither /proc nor /sys, and none of Linux's calls."""

    class Nowhere(type(tmp_path)):  # type: ignore[misc]
        def __new__(cls, *parts: str) -> Path:
            return tmp_path / "nowhere" / "/".join(parts).lstrip("/")

    monkeypatch.setattr(machine_module, "Path", Nowhere)
    for name in ("_CPUS", "_RT_RUNTIME", "_RT_PERIOD"):
        monkeypatch.setattr(machine_module, name, tmp_path / "nowhere")
    for name in ("sched_getaffinity", "sched_getscheduler"):
        monkeypatch.delattr(os, name)
    monkeypatch.setattr(machine_module.ctypes, "CDLL", lambda *_: object())
    told = machine({"scheduler": "there is none"})
    assert told["real_time_share"] is None
    assert told["hypervisor"] is None
    assert told["measures"]["affinity"] == {"in_force": False, "value": None, "reason": NOT_ASKED}
    assert told["measures"]["scheduler"]["reason"] == "there is none"
    assert told["measures"]["memory_locked"]["value"] is None
    assert usage()["stolen_s"] == 0.0
