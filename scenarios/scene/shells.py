"""What the arms look like: shells in the manner of the Adept Viper s650, along the arm's lengths.

Only for pictures: nothing here is weighed and nothing touches. Each part lies in the frame of its
body, see `plant.arm_model`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from plant.viper import ArmSpec, EndEffector
from scenarios.scene.meshes import (
    Array,
    Mesh,
    Outline,
    blend,
    drum,
    lathe,
    rectangle,
    slab,
    stadium,
)


@dataclass(frozen=True, eq=False)
class Part:
    """A mesh in the frame of a body, and what it is made of."""

    mesh: Mesh
    material: str


def arm_shells(spec: ArmSpec) -> Mapping[str, Sequence[Part]]:
    """Parts of the base and of links 1 to 6, by the tail of the body's name."""
    d1, a1, a2, a3, d4, d6 = (
        float(q.si) for q in (spec.d1, spec.a1, spec.a2, spec.a3, spec.d4, spec.d6)
    )
    return {
        "base": _base(d1),
        "link1": _turret(d1, a1),
        "link2": _upper_arm(a2),
        "link3": _elbow(a3, d4),
        "link4": _forearm(d4),
        "link5": _wrist(d6),
        "link6": _flange(d6),
    }


def instrument(effector: EndEffector) -> Sequence[Part]:
    """Adapter, force sensor, slim shaft and tip, in the flange's frame."""
    reach, ball = float(effector.reach.si), 0.004
    shaft = reach - 1.6 * ball
    return [
        Part(lathe([(0.024, 0.0), (0.024, 0.004), (0.024, 0.004), (0.0165, 0.010),
                    (0.0165, 0.012)]), "steel"),
        Part(drum(0.0165, 0.012, 0.030, 0.0012), "dark steel"),
        Part(drum(0.0167, 0.0185, 0.0215, 0.0004), "accent"),
        Part(lathe([(0.0125, 0.030), (0.0115, 0.034), (0.0052, 0.046), (0.0032, 0.050),
                    (0.0030, shaft)]), "steel"),
        Part(drum(0.0040, 0.060, 0.064, 0.0008), "dark steel"),
        Part(_ellipsoid(ball, 2.0 * ball).placed(shift(0.0, 0.0, reach - 2.0 * ball)), "steel"),
    ]  # fmt: skip


def pad_holder(effector: EndEffector) -> Sequence[Part]:
    """Bracket and cup of the tissue, in the flange's frame; the tissue itself is apart."""
    reach, rise = float(effector.reach.si), float(effector.rise.si)
    up = facing((-1.0, 0.0, 0.0), (0.0, 0.0, reach))
    foot = rectangle((-0.016, 0.016), (-0.014, 0.014), 0.006)
    return [
        Part(lathe([(0.024, 0.0), (0.024, 0.004), (0.024, 0.004), (0.017, 0.009), (0.017, 0.010)]),
             "steel"),
        Part(slab(foot, 0.008, reach + 0.014, 0.003), "dark steel"),
        Part(drum(0.013, 0.010, 0.40 * rise, 0.002).placed(up), "steel"),
        Part(lathe([(0.016, 0.34 * rise), (0.026, 0.36 * rise), (0.0385, 0.50 * rise),
                    (0.0400, 0.54 * rise), (0.0400, 0.64 * rise), (0.0392, 0.66 * rise),
                    (0.0375, 0.66 * rise), (0.0370, 0.60 * rise)]).placed(up), "shell"),
    ]  # fmt: skip


def _base(d1: float) -> list[Part]:
    top = 0.42 * d1
    foot = rectangle((-0.105, 0.098), (-0.098, 0.098), 0.022)
    lower = rectangle((-0.094, 0.084), (-0.084, 0.084), 0.045)
    upper = rectangle((-0.080, 0.080), (-0.080, 0.080), 0.079)
    back = facing((-1.0, 0.0, 0.0), (-0.090, 0.0, 0.066))
    plate = rectangle((-0.048, 0.048), (-0.026, 0.026), 0.006)
    parts = [
        Part(slab(foot, 0.0, 0.018, 0.004), "joint"),
        Part(blend([(lower, 0.018), (lower, 0.070), (upper, 0.112), (upper, top)], 0.006), "shell"),
        Part(slab(plate, 0.0, 0.010, 0.003).placed(back), "joint"),
    ]
    parts += [
        Part(drum(0.012, 0.008, 0.022, 0.002).placed(back @ shift(y, 0.0, 0.0)), "dark steel")
        for y in (-0.024, 0.024)
    ]
    parts += [
        Part(drum(0.008, 0.016, 0.024, 0.002).placed(shift(x, y, 0.0)), "steel")
        for x in (-0.090, 0.083)
        for y in (-0.083, 0.083)
    ]
    return parts


def _turret(d1: float, a1: float) -> list[Part]:
    bottom = 0.42 * d1
    low = rectangle((-0.086, 0.086), (-0.086, 0.086), 0.085)
    mid = rectangle((-0.090, 0.092), (-0.088, 0.088), 0.055)
    high = rectangle((-0.082, 0.080), (-0.080, 0.080), 0.045)
    trunk = blend(
        [(low, bottom + 0.008), (low, bottom + 0.022), (mid, bottom + 0.052), (mid, d1 - 0.080),
         (high, d1 - 0.030)],
        0.020,
    )  # fmt: skip
    cheek = stadium((a1, d1), 0.066, (0.010, d1 - 0.090), 0.076)
    return [
        Part(drum(0.076, bottom - 0.004, bottom + 0.010, 0.002), "joint"),
        Part(trunk, "shell"),
        *_cheeks(cheek, 0.056, 0.098, 0.012, side_view()),
        *_caps(0.050, 0.098, (a1, d1), side_view()),
    ]


def _upper_arm(a2: float) -> list[Part]:
    beam = stadium((0.0, 0.0), 0.064, (a2, 0.0), 0.052)
    inlay = stadium((0.085, 0.0), 0.032, (a2 - 0.070, 0.0), 0.027)
    return [
        Part(slab(beam, -0.052, 0.052, 0.014), "shell"),
        *_cheeks(inlay, 0.050, 0.0535, 0.0015, np.eye(4), material="light"),
        Part(drum(0.050, -0.0555, 0.0555, 0.002), "joint"),
        Part(drum(0.042, -0.0565, 0.0565, 0.002).placed(shift(a2, 0.0, 0.0)), "joint"),
    ]


def _elbow(a3: float, d4: float) -> list[Part]:
    end = 0.45 * d4
    along = side_view(-a3)
    back = rectangle((-0.056, 0.052), (-0.070, 0.070), 0.030)
    full = rectangle((-0.058, 0.056), (-0.076, 0.076), 0.032)
    waist = rectangle((-0.054, 0.054), (-0.058, 0.058), 0.040)
    round_ = rectangle((-0.050, 0.050), (-0.050, 0.050), 0.049)
    housing = blend(
        [(back, -0.082), (full, -0.060), (full, 0.030), (waist, 0.075), (round_, 0.110),
         (round_, end - 0.004)],
        0.014,
    )  # fmt: skip
    cheek = stadium((0.0, 0.0), 0.054, (-a3 + 0.006, 0.008), 0.056)
    return [
        Part(housing.placed(along), "shell"),
        *_cheeks(cheek, 0.056, 0.084, 0.010, np.eye(4)),
        *_caps(0.041, 0.084, (0.0, 0.0), np.eye(4)),
        Part(drum(0.033, -0.0845, -0.080, 0.002).placed(along), "joint"),
    ]


def _forearm(d4: float) -> list[Part]:
    start, neck = 0.45 * d4, d4 - 0.062
    tube = rectangle((-0.047, 0.047), (-0.047, 0.047), 0.046)
    slim = rectangle((-0.041, 0.041), (-0.041, 0.041), 0.040)
    yoke = rectangle((-0.034, 0.034), (-0.046, 0.046), 0.020)
    prong = stadium((0.0, d4), 0.032, (0.0, neck - 0.012), 0.033)
    return [
        Part(drum(0.044, start - 0.006, start + 0.008, 0.002), "joint"),
        Part(drum(0.0478, start + 0.016, start + 0.020, 0.001), "accent"),
        Part(
            blend([(tube, start + 0.006), (tube, start + 0.030), (slim, neck - 0.020),
                   (yoke, neck - 0.002), (yoke, neck + 0.024)], 0.006),
            "shell",
        ),
        *_cheeks(prong, 0.0285, 0.046, 0.007, side_view()),
        *_caps(0.024, 0.046, (0.0, d4), side_view()),
    ]  # fmt: skip


def _wrist(d6: float) -> list[Part]:
    knuckle = stadium((0.0, 0.0), 0.030, (0.0, 0.4 * d6), 0.026)
    return [
        Part(drum(0.022, -0.030, 0.030, 0.002), "joint"),
        Part(slab(knuckle, -0.0265, 0.0265, 0.009), "shell"),
        Part(
            drum(0.0275, 0.3 * d6, 0.68 * d6, 0.004).placed(facing((0.0, 1.0, 0.0))), "shell"
        ),
    ]  # fmt: skip


def _flange(d6: float) -> list[Part]:
    bolts = [
        Part(drum(0.0022, d6 - 0.001, d6 + 0.001, 0.0005).placed(
            shift(0.020 * np.cos(t), 0.020 * np.sin(t), 0.0)), "joint")
        for t in np.pi * (0.25 + 0.5 * np.arange(4))
    ]  # fmt: skip
    return [
        Part(drum(0.0235, 0.66 * d6, 0.76 * d6, 0.001), "joint"),
        Part(drum(0.0265, 0.74 * d6, d6, 0.0015), "steel"),
        *bolts,
    ]


def _cheeks(
    outline: Outline, inner: float, outer: float, fillet: float, pose: Array, *,
    material: str = "shell",
) -> list[Part]:  # fmt: skip
    """Two plates of one outline on both sides of the plane in which it lies."""
    return [
        Part(slab(outline, low, high, fillet).placed(pose), material)
        for low, high in ((inner, outer), (-outer, -inner))
    ]


def _caps(radius: float, out: float, at: tuple[float, float], pose: Array) -> list[Part]:
    """Covers of both ends of a joint's axis through ``at``."""
    cover = lathe(
        [(radius, -0.002), (radius, 0.003), (radius - 0.0015, 0.0045), (0.80 * radius, 0.0050),
         (0.80 * radius, 0.0050), (0.76 * radius, 0.0025), (0.76 * radius, 0.0025),
         (0.30 * radius, 0.0025), (0.30 * radius, 0.0025), (0.26 * radius, 0.0045),
         (0.01 * radius, 0.0048)]
    )  # fmt: skip
    axis = pose[:3, 2]
    centre = pose[:3, 3] + pose[:3, :2] @ np.array(at)
    return [
        Part(cover.placed(facing(tuple(s * axis), tuple(centre + s * out * axis))), "joint")
        for s in (-1.0, 1.0)
    ]


def _ellipsoid(radius: float, height: float) -> Mesh:
    angle = np.linspace(-np.pi / 2.0, np.pi / 2.0, 17)
    return lathe(
        [
            (max(radius * float(np.cos(t)), 1e-5), height / 2.0 * (1.0 + float(np.sin(t))))
            for t in angle
        ]
    )


def side_view(x: float = 0.0) -> Array:
    """Pose ``(4, 4)`` that takes x and y of an outline to x and z, and its height to -y."""
    pose = np.eye(4)
    pose[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    pose[0, 3] = x
    return pose


def facing(direction: Sequence[float], at: Sequence[float] = (0.0, 0.0, 0.0)) -> Array:
    """Pose ``(4, 4)`` at a point [m] whose z axis is a direction along one of the axes."""
    z = np.asarray(direction, dtype=np.float64)
    x = np.roll(np.abs(z), 1)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    pose[:3, 3] = at
    return pose


def shift(x: float, y: float, z: float) -> Array:
    """Pose ``(4, 4)`` of a displacement [m]."""
    pose = np.eye(4)
    pose[:3, 3] = (x, y, z)
    return pose
