"""Colours: seen by everyone, on both grounds."""

from __future__ import annotations

import re
from importlib import resources
from itertools import combinations

import numpy as np
import pytest

CSS = (resources.files("bench.report") / "assets" / "report.css").read_text(encoding="utf-8")
PAIRS = dict(re.findall(r"--([\w-]+): light-dark\((#\w+, #\w+)\)", CSS))
NAMES = [f"series-{i}" for i in range(6)]
# Machado, Oliveira and Fernandes 2009, complete protanopia, deuteranopia, tritanopia.
BLIND = {
    "none": np.eye(3),
    "protan": np.array([[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
                        [-0.003882, -0.048116, 1.051998]]),
    "deutan": np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                        [-0.011820, 0.042940, 0.968881]]),
    "tritan": np.array([[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
                        [0.004733, 0.691367, 0.303900]]),
}  # fmt: skip


def linear(name: str, theme: int) -> np.ndarray:
    text = PAIRS[name].split(", ")[theme][1:]
    text = "".join(2 * c for c in text) if len(text) == 3 else text
    value = np.array([int(text[i : i + 2], 16) for i in (0, 2, 4)]) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def contrast(one: str, other: str, theme: int) -> float:
    low, high = sorted(float(linear(n, theme) @ [0.2126, 0.7152, 0.0722]) for n in (one, other))
    return (high + 0.05) / (low + 0.05)


def lab(rgb: np.ndarray) -> np.ndarray:
    to_xyz = np.array(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    )
    t = to_xyz @ np.clip(rgb, 0, 1) / [0.9505, 1.0, 1.089]
    f = np.where(t > 0.008856, np.cbrt(t), 7.787 * t + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("theme", [0, 1], ids=["light", "dark"])
def test_text_has_its_contrast_and_so_have_lines(theme):
    for ground in ("page", "raised"):
        for name in ("ink", "quiet", "accent", "bound"):
            assert contrast(name, ground, theme) >= 4.5, (name, ground)
    for name in (*NAMES, "held", "calm", "watch", "alarm", "edge"):
        assert contrast(name, "page", theme) >= 3.0, name


@pytest.mark.parametrize("theme", [0, 1], ids=["light", "dark"])
@pytest.mark.parametrize("kind", BLIND)
@pytest.mark.parametrize("group", [NAMES[:4], ["calm", "watch", "alarm"]], ids=["series", "levels"])
def test_colours_are_told_apart(theme, kind, group):
    """The first four series, and levels; all series differ by their dashes, levels by width."""
    for one, other in combinations(group, 2):
        seen = [lab(BLIND[kind] @ linear(name, theme)) for name in (one, other)]
        assert np.linalg.norm(seen[0] - seen[1]) > 10, (one, other)
