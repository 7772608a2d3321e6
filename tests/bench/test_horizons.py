"""The study of long horizons: its arithmetic, one small run, and bad input."""

import numpy as np
import pytest

from bench.horizons import Timing, crossover, exponent, main


def timing(form: str, whole: float) -> Timing:
    rows = np.array([0.0, 2.0, 3.0])
    times = whole * np.array([1.0, 1.0, 3.0])
    return Timing(form, times, times, times, np.zeros((3, 1)), rows, rows)


def test_the_exponent_is_that_of_a_power():
    assert exponent([64, 128, 512], [3 * n**1.2 for n in (64, 128, 512)]) == pytest.approx(1.2)


def test_the_crossover_is_where_it_stays_faster():
    def found(*pairs):
        return [
            (h, timing(form, t))
            for h, *both in pairs
            for form, t in zip(("structured", "condensed"), both, strict=True)
        ]

    assert crossover(found((8, 2, 1), (16, 1, 2), (32, 3, 2), (64, 1, 9))) == 64
    assert crossover(found((8, 1, 2), (16, 1, 3))) == 8
    assert crossover(found((8, 2, 1))) is None
    assert crossover([(8, timing("structured", 1.0))]) is None


def test_cycles_with_an_active_row_are_told_apart():
    assert timing("structured", 1.0).when_active("solve") == 2.0


def test_a_small_run_prints_both_forms_and_that_they_agree(capsys):
    asked = "--horizon 4,9 --duration 0.06 --passes 1 --condensed-up-to 4"
    assert main(asked.split()) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()[1:]]
    assert [line[:2] for line in lines[:3]] == [
        ["4", "structured"], ["4", "condensed"], ["9", "structured"],
    ]  # fmt: skip
    assert all(float(line[-1]) < 1e-5 for line in lines[:3])
    assert all(float(line[3]) > 0 for line in lines[:3])


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ("--horizon x", "invalid literal"),
        ("--horizon 0", "controller.horizon"),
        ("--horizon 4 --passes 0", "--passes must be at least 1"),
        ("--horizon 4 --duration -1", "duration"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(asked, told, capsys):
    assert main(asked.split()) == 2
    error = capsys.readouterr().err
    assert told in error
    assert error.count("\n") == 1
