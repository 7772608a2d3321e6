from collections.abc import Iterator
from dataclasses import fields, is_dataclass

import numpy as np
import pytest

from plant.viper import HEART, TOOL, VIPER_S650, Quantity


def quantities(record: object, path: str) -> Iterator[tuple[str, Quantity]]:
    for field in fields(record):  # type: ignore[arg-type]
        value = getattr(record, field.name)
        if isinstance(value, Quantity):
            yield f"{path}.{field.name}", value
        elif is_dataclass(value):
            yield from quantities(value, f"{path}.{field.name}")


ALL = dict([*quantities(VIPER_S650, "arm"), *quantities(HEART, "heart"), *quantities(TOOL, "tool")])
ESTIMATED = {"arm.link_mass", "arm.link_radius", "arm.armature", "arm.torque_limit"} | {
    f"{arm}.effector.{name}" for arm in ("heart", "tool") for name in ("mass", "reach", "rise")
}


def test_every_figure_is_found() -> None:
    assert len(ALL) == 14 + 2 * 7


@pytest.mark.parametrize("name", ALL)
def test_every_figure_has_a_source_and_a_known_unit(name: str) -> None:
    quantity = ALL[name]
    assert len(quantity.source) > 10
    assert np.isfinite(quantity.si).all()


def test_estimates_are_flagged_and_say_so() -> None:
    assert {name for name, quantity in ALL.items() if quantity.estimated} == ESTIMATED
    for name, quantity in ALL.items():
        assert quantity.source.startswith("estimate: ") == (name in ESTIMATED)


def test_angles_become_radians() -> None:
    assert VIPER_S650.lower[1] == pytest.approx(-190 / 180 * np.pi, abs=1e-15)
    assert VIPER_S650.upper[2] == pytest.approx(256 / 180 * np.pi, abs=1e-15)
    assert VIPER_S650.joint_speed.si[5] == pytest.approx(600 / 180 * np.pi, abs=1e-15)
    assert VIPER_S650.coulomb_friction.si.tolist() == [9.6, 8.9, 6.2, 3.6, 2.4, 1.6]


def test_unknown_unit_is_refused() -> None:
    with pytest.raises(KeyError, match="inch"):
        _ = Quantity(1.0, "inch", "a test").si


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("joint_range", (6, 2)),
        ("joint_speed", (6,)),
        ("coulomb_friction", (6,)),
        ("viscous_friction", (6,)),
        ("armature", (6,)),
        ("torque_limit", (6,)),
        ("link_mass", (7,)),
        ("link_radius", (7,)),
    ],
)
def test_array_shapes(name: str, shape: tuple[int, ...]) -> None:
    assert getattr(VIPER_S650, name).si.shape == shape


def test_arm_weighs_28_kg() -> None:
    assert VIPER_S650.link_mass.si.sum() == pytest.approx(28.0, abs=1e-12)


def test_torque_limit_leaves_room_over_friction_at_full_speed() -> None:
    spec = VIPER_S650
    friction = spec.coulomb_friction.si + spec.viscous_friction.si * spec.joint_speed.si
    assert (friction < spec.torque_limit.si).all()


def test_bases_stand_as_designed() -> None:
    assert TOOL.base_x.si - HEART.base_x.si == pytest.approx(0.92, abs=1e-12)
    assert HEART.home_tip is TOOL.home_tip
    assert HEART.home_tip.value == (0.0, 0.0, 0.42)
