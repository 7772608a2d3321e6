"""An arm of one's own on the command line: what is wrong with it, and that a run repeats."""

from __future__ import annotations

import json

import pytest

SHORT = ("run", "other-arm", "--duration", "0.05", "--json")


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ('cell.arm.file="/nowhere/a.xml"', "a.xml: there is no such file in /nowhere"),
        ("cell.arm.tip=flang", "cell.arm.tip: panda.xml has no site or body 'flang', did you mean"),
        ("cell.arm.joint_speed=[1.0, 2.0]", "cell.arm.joint_speed: must be one number or 7"),
        ("cell.arm.base=[2.0, 0.0, 0.0]", "cell.arm.home: no posture near the file's first"),
        ("cell.arm.tips=a", "cell.arm.tips: unknown key"),
    ],
)
def test_bad_input_is_refused_in_one_line_and_leaves_nothing(setting, told, refuse):
    assert told in refuse(*SHORT, "--set", setting)


def test_a_run_repeats_from_what_it_wrote(leave, tmp_path):
    code, first, _ = leave(*SHORT, "--out", "first")
    assert code == 0
    code, second, _ = leave("run", str(tmp_path / "first" / "config.toml"), "--json")
    assert code == 0
    assert json.loads(first)["axes"] == json.loads(second)["axes"]
