"""Where a picture is taken from, and where a point of the world comes to lie in it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from scenarios.scene.meshes import Array


@dataclass(frozen=True)
class View:
    """A direction to look in."""

    azimuth: float
    """About the vertical: 0 along the world's x, 90 along its y [deg]."""
    elevation: float
    """Negative looks down [deg]."""


VIEWS: Mapping[str, View] = {
    "overview": View(78.0, -14.0),
    "front": View(90.0, -6.0),
    "left": View(35.0, -16.0),
    "right": View(145.0, -16.0),
    "above": View(90.0, -55.0),
    "back": View(-70.0, -16.0),
}
"""Of the whole cell; the first is the default."""
CLOSE = View(62.0, -22.0)
"""Of the contact."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera in its place."""

    view: View
    position: Array
    """``(3,)`` [m]"""
    opening: float
    """Vertical angle [deg]."""
    aspect: float
    """Width by height of the picture."""
    distance: float = 1.0
    """To what a viewer turns about [m]."""

    @property
    def forward(self) -> Array:
        """Unit vector into the picture, ``(3,)``."""
        return directions(self.view)[2]

    def place(self, theirs: Any) -> None:
        """Put a ``mujoco.MjvCamera`` here; its opening is that of the model."""
        theirs.type = mujoco.mjtCamera.mjCAMERA_FREE
        theirs.azimuth, theirs.elevation = self.view.azimuth, self.view.elevation
        theirs.distance = self.distance
        theirs.lookat[:] = self.position + self.distance * self.forward

    def project(self, points: Array, width: int, height: int) -> Array:
        """Where points ``(..., 3)`` lie in a picture, ``(..., 2)`` [pixels] from its upper left.

        Points must lie in front of the camera.
        """
        axes = np.column_stack(directions(self.view))
        right, up, depth = np.moveaxis((points - self.position) @ axes, -1, 0)
        scale = height / (2.0 * np.tan(np.deg2rad(self.opening) / 2.0))
        return np.stack(
            [width / 2.0 + scale * right / depth, height / 2.0 - scale * up / depth], axis=-1
        )


def directions(view: View) -> tuple[Array, Array, Array]:
    """Unit vectors to the right, upwards and into the picture, in the world."""
    a, e = np.deg2rad(view.azimuth), np.deg2rad(view.elevation)
    forward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([np.sin(a), -np.cos(a), 0.0])
    return right, np.cross(right, forward), forward


def around(
    view: View, points: Array, opening: float, aspect: float, margin: float = 0.08
) -> Camera:
    """Return the nearest camera that has all points in its picture.

    Args:
        view: see there.
        points: ``(n, 3)`` [m].
        opening: vertical angle of the camera [deg].
        aspect: width by height of the picture.
        margin: share of the picture's half that stays free at each side.
    """
    right, up, forward = directions(view)
    depth = points @ forward
    tangent = np.tan(np.deg2rad(opening) / 2.0) * (1.0 - margin)
    # Seen from p, a point at r lies inside where |r - p| <= tangent (depth - p_forward): two
    # half-planes an axis, and their corner is the nearest place.
    across, across_depth = _corner(points @ right, depth, tangent * aspect)
    upwards, upwards_depth = _corner(points @ up, depth, tangent)
    place = across * right + upwards * up + min(across_depth, upwards_depth) * forward
    return Camera(view, place, opening, aspect)


def towards(view: View, point: Array, height: float, opening: float, aspect: float) -> Camera:
    """Return the camera with a point in its middle and a height [m] in view there."""
    _, _, forward = directions(view)
    distance = height / (2.0 * np.tan(np.deg2rad(opening) / 2.0))
    return Camera(view, point - distance * forward, opening, aspect)


def _corner(places: Array, depth: Array, tangent: float) -> tuple[float, float]:
    low = float(np.min(depth - places / tangent))
    high = float(np.min(depth + places / tangent))
    return tangent * (high - low) / 2.0, (high + low) / 2.0
