"""Enumerations in the cache: read back as they were, made anew when damaged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from qpmpc.explicit import archive
from qpmpc.native.errors import CacheError

LIMITS = (10, 20)


@pytest.fixture
def stored(mixed, tmp_path, monkeypatch):
    monkeypatch.setenv("PULSEMPC_CACHE", str(tmp_path / "own"))
    name = archive.name_of(mixed.qp, mixed.parameters, LIMITS)
    archive.save(name, mixed.all_of_them, mixed.qp.m)
    return tmp_path / "own" / name


def test_is_read_back_as_it_was(mixed, stored):
    found, before = archive.load(stored.name, mixed.family), mixed.all_of_them
    assert found is not None
    assert [each.key for each in found.regions] == [each.key for each in before.regions]
    for one, other in zip(found.regions, before.regions, strict=True):
        np.testing.assert_array_equal(one.inverse, other.inverse)
        np.testing.assert_array_equal(one.shift, other.shift)
    assert found.links == before.links
    assert (found.complete, found.lost, found.covered) == (
        before.complete, before.lost, before.covered,
    )  # fmt: skip
    assert list(stored.parent.iterdir()) == [stored]
    assert stored.parent.stat().st_mode & 0o777 == 0o700


def test_is_not_there_before_it_is_made(mixed, stored):
    assert archive.load("regions-of-another.npz", mixed.family) is None


@pytest.mark.parametrize("damage", ["cut", "changed", "empty", "text"])
def test_a_damaged_file_is_none(mixed, stored, damage):
    content = stored.read_bytes()
    middle = len(content) // 2
    stored.write_bytes(
        {
            "cut": content[:middle],
            "changed": content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :],
            "empty": b"",
            "text": b"regions",
        }[damage]
    )
    assert archive.load(stored.name, mixed.family) is None
    archive.save(stored.name, mixed.all_of_them, mixed.qp.m)
    assert archive.load(stored.name, mixed.family) is not None


def test_what_is_of_another_problem_is_none(contact, mixed, stored):
    assert archive.load(stored.name, contact(2).family) is None


def test_a_file_that_others_may_write_to_is_refused(mixed, stored):
    stored.chmod(0o722)
    with pytest.raises(CacheError, match="others may write"):
        archive.load(stored.name, mixed.family)


def test_the_name_follows_from_all_that_matters(mixed):
    qp, known = mixed.qp, mixed.parameters
    changed = [
        (replace(qp, P=1.1 * qp.P), known, LIMITS),
        (replace(qp, A=1.1 * qp.A), known, LIMITS),
        (replace(qp, linear=2.0 * qp.linear), known, LIMITS),
        (replace(qp, quadratic=qp.quadratic + 0.1), known, LIMITS),
        (qp, replace(known, gradient=2.0 * known.gradient), LIMITS),
        (qp, replace(known, q0=known.q0 + 1.0), LIMITS),
        (qp, replace(known, offset=2.0 * known.offset), LIMITS),
        (qp, replace(known, l0=known.l0 - 1.0), LIMITS),
        (qp, replace(known, u0=known.u0 + 1.0), LIMITS),
        (qp, known, (10, 21)),
    ]
    names = {archive.name_of(*each) for each in changed}
    assert len(names) == len(changed)
    assert archive.name_of(qp, known, LIMITS) not in names


def test_the_last_digits_do_not_matter(mixed):
    qp, known = mixed.qp, mixed.parameters
    rounded = replace(qp, A=qp.A * (1 + 1e-15)), replace(known, q0=known.q0 - 0.0)
    assert archive.name_of(*rounded, LIMITS) == archive.name_of(qp, known, LIMITS)


def test_a_folder_that_cannot_be_written_to_is_said(mixed, stored, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(archive, "store", full)
    with pytest.raises(CacheError, match="No space left"):
        archive.save("regions-new.npz", mixed.all_of_them, mixed.qp.m)
    assert list(stored.parent.iterdir()) == [stored]
