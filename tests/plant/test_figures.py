"""The page's tables are what the code has."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import pytest

import plant
from plant import figures
from plant.config import ToolConfig
from plant.sensors import SENSORS
from plant.viper import VIPER_S650

PAGE = Path(plant.__file__).parents[1] / "docs" / "plant.md"
ROWS = [row for rows in figures.tables().values() for row in rows]


def test_the_page_has_the_tables_as_they_are():
    text = PAGE.read_text(encoding="utf-8")
    shown = text[text.index(figures.BEGIN) + len(figures.BEGIN) : text.index(figures.END)]
    assert shown.strip() == figures.markdown().strip(), "python -m plant.figures docs/plant.md"


def test_every_figure_has_a_source_or_says_that_it_is_estimated():
    assert all(row.source for row in ROWS)
    assert sum("*estimated*" in row.source for row in ROWS) > 15


def test_an_estimate_is_called_one_and_nothing_else_is():
    """By the flags of the code, not by the words of the page."""
    for f in fields(VIPER_S650):
        quantity = getattr(VIPER_S650, f.name)
        row = next(r for r in ROWS if r.name == figures._NAMES[f.name])
        assert ("*estimated*" in row.source) == quantity.estimated, f.name


def test_nothing_is_left_out():
    told = " ".join(row.name for row in ROWS)
    assert set(figures._NAMES) == {f.name for f in fields(VIPER_S650)}
    assert set(figures._LOOPS) == {f.name for f in fields(ToolConfig)}
    for model in SENSORS:
        assert f"`{model}`" in told


def test_a_value_that_changes_shows(monkeypatch):
    before = figures.markdown()
    monkeypatch.setattr(figures, "SERVO_STIFFNESS", 41000.0)
    assert figures.markdown() != before


def test_a_page_is_written_between_its_marks_only(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"before\n{figures.BEGIN}\nold\n{figures.END}\nafter\n")
    figures.main([str(page)])
    text = page.read_text()
    assert text.startswith(f"before\n{figures.BEGIN}\n")
    assert text.endswith(f"{figures.END}\nafter\n")
    assert "old" not in text
    assert figures.markdown() in text
    with pytest.raises(FileNotFoundError):
        figures.main([str(tmp_path / "none.md")])


def test_without_a_page_it_prints(capsys):
    figures.main([])
    assert capsys.readouterr().out == figures.markdown()
