"""What is drawn instead of every sample says the same."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bench.report.reduce import bucket, extremes, histogram, smooth, spectrum, together

finite = st.floats(-1e6, 1e6)


@given(st.integers(1, 10**6), st.integers(2, 10**5))
def test_a_bucket_is_as_wide_as_it_must_be(cycles, limit):
    width = bucket(cycles, limit)
    assert width == 1 if cycles <= limit else 2 * np.ceil(cycles / width) <= limit + 1
    if width > 1:
        assert 2 * cycles / (width - 1) > limit


@given(arrays(np.float64, st.integers(1, 200), elements=finite), st.integers(2, 50))
def test_extremes_are_those_of_each_bucket_in_their_order(values, width):
    found = extremes(values, width).reshape(-1, 2)
    assert len(found) == -(-len(values) // width)
    for k, pair in enumerate(found):
        part = values[k * width : (k + 1) * width]
        assert sorted(pair) == [part.min(), part.max()]
        assert list(part).index(pair[0]) <= len(part) - 1 - list(part[::-1]).index(pair[1])


def test_extremes_look_past_what_is_not_known():
    values = np.array([np.nan, 3.0, 1.0, np.nan, np.nan, np.nan, np.nan, 2.0])
    np.testing.assert_array_equal(extremes(values, 4), [3.0, 1.0, 2.0, 2.0])
    assert np.isnan(extremes(np.full(4, np.nan), 2)).all()
    assert extremes(values, 1) is values


@given(arrays(np.uint16, st.integers(1, 100), elements=st.integers(0, 2**12)), st.integers(2, 20))
def test_no_state_is_lost(masks, width):
    found = together(masks, width)
    for k in range(-(-len(masks) // width)):
        union = 0
        for mask in masks[k * width : (k + 1) * width]:
            union |= int(mask)
        assert found[2 * k] == found[2 * k + 1] == union


@given(arrays(np.float64, st.integers(1, 100), elements=st.floats(-0.99, 0.99)))
def test_shares_are_of_all(values):
    assert histogram(values, np.linspace(-1, 1, 21)).sum() == pytest.approx(100)


def test_a_sine_has_its_power_at_its_frequency():
    t = np.arange(15_000) * 1e-3
    f, density = spectrum(3.0 * np.sin(2 * np.pi * 12.5 * t), 1e-3)
    assert f[density.argmax()] == pytest.approx(12.5, abs=f[0])
    power = (density**2).sum() * f[0]  # Parseval: the mean square
    assert power == pytest.approx(3.0**2 / 2, rel=1e-3)


def test_white_noise_is_flat_and_its_level_is_known():
    noise = np.random.default_rng(0).normal(0, 0.5, 200_000)
    f, density = spectrum(noise, 1e-3)
    level = 0.5 * np.sqrt(2 * 1e-3)
    np.testing.assert_allclose(np.sqrt(np.mean(density**2)), level, rtol=0.02)
    at, smoothed = smooth(f, density)
    assert len(at) < len(f) / 8
    fine = at <= 10
    np.testing.assert_array_equal(smoothed[fine], density[f <= 10])
    np.testing.assert_allclose(smoothed[at > 100], level, rtol=0.15)
    assert (np.diff(at) > 0).all()


@pytest.mark.parametrize("n", [0, 1, 15])
def test_too_little_has_no_spectrum(n):
    f, density = spectrum(np.ones(n), 1e-3)
    assert f.size == density.size == 0
    assert smooth(f, density)[0].size == 0
