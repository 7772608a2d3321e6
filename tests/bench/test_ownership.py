"""Whoever else claims our import names is told."""

from __future__ import annotations

import subprocess
import sys

import pytest

from bench import cli, ownership

CLEAN = {"qpmpc": ["pulsempc"], "plant": ["pulsempc"], "numpy": ["numpy"]}


def claim(monkeypatch, owners):
    monkeypatch.setattr(ownership, "packages_distributions", lambda: owners)


@pytest.mark.parametrize("owners", [{}, CLEAN, {"qpmpc": ["pulsempc", "pulsempc"]}])
def test_without_a_stranger_nothing_is_told(owners, monkeypatch):
    claim(monkeypatch, owners)
    assert ownership.foreign_owners() == {}


@pytest.mark.parametrize("owners", [["qpmpc"], ["pulsempc", "qpmpc"], ["qpmpc", "qpmpc"]])
def test_the_other_qpmpc_is_told(owners, monkeypatch):
    claim(monkeypatch, CLEAN | {"qpmpc": owners})
    assert ownership.foreign_owners() == {"qpmpc": ["qpmpc"]}


@pytest.mark.parametrize("root", ["plant", "scenarios", "bench"])
def test_every_root_is_looked_at(root, monkeypatch):
    claim(monkeypatch, CLEAN | {root: ["pulsempc", "zebra", "ant"]})
    assert ownership.foreign_owners() == {root: ["ant", "zebra"]}


@pytest.mark.parametrize("arguments", [["run"], ["backends"], ["scenarios"]])
def test_the_command_line_refuses_to_start(arguments, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    claim(monkeypatch, {"qpmpc": ["pulsempc", "qpmpc"], "plant": ["other-plant"]})
    with pytest.raises(SystemExit) as left:
        cli.main(arguments)
    assert left.value.code == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("pulsempc: ")
    assert said.err.count("\n") == 1
    for word in ("'qpmpc' by qpmpc", "'plant' by other-plant", "pip uninstall other-plant qpmpc"):
        assert word in said.err
    assert list(tmp_path.iterdir()) == []


def test_nothing_that_a_stranger_could_break_is_imported_before_the_check():
    code = (
        "import sys, bench.cli; "
        "print([m for m in sys.modules if m.split('.')[0] in ('qpmpc', 'plant', 'scenarios')])"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"
