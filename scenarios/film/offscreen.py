"""Pictures without a screen: a GL context from EGL or OSMesa, whichever works here."""

import os
import subprocess
import sys
from functools import cache
from types import TracebackType
from typing import Any, Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from scenarios.errors import ScenarioError
from scenarios.scene.camera import Camera
from scenarios.scene.scene import Scene

_TRIAL = (
    "import sys, importlib; c = importlib.import_module('mujoco.' + sys.argv[1]).GLContext(16, 16);"
    "c.make_current(); import mujoco; m = mujoco.MjModel.from_xml_string('<mujoco/>');"
    "mujoco.MjrContext(m, 100).free(); c.free()"
)
_PLATFORM = "PYOPENGL_PLATFORM"
_PATIENCE = 120.0
"""How long a trial may take [s]."""


class NoRendererError(ScenarioError):
    """Nothing here can draw without a screen."""

    def __init__(self) -> None:
        super().__init__(
            "no off-screen rendering: neither EGL nor OSMesa works here; on Debian or Ubuntu: "
            "apt install libosmesa6 (or libegl1 and libgl1-mesa-dri)"
        )


@cache
def renderer() -> str | None:
    """Return which library draws without a screen, ``egl`` or ``osmesa``; None if neither does.

    Each is tried in a process of its own, as OpenGL's bindings keep to the first that is loaded.
    """
    environment = {k: v for k, v in os.environ.items() if k not in {"MUJOCO_GL", _PLATFORM}}
    for kind in ("egl", "osmesa"):
        try:
            tried = subprocess.run(
                [sys.executable, "-c", _TRIAL, kind],
                env=environment, capture_output=True, timeout=_PATIENCE, check=False,
            )  # fmt: skip
        except (OSError, subprocess.TimeoutExpired):
            continue
        if tried.returncode == 0:
            return kind
    return None


class Offscreen:
    """Takes pictures of a scene."""

    def __init__(self, scene: Scene, width: int, height: int) -> None:
        """Make a GL context.

        Args:
            scene: what is drawn.
            width, height: of the largest picture [pixels].

        Raises:
            NoRendererError: there is none to be had.
        """
        kind = renderer()
        if kind is None:
            raise NoRendererError
        self._gl = _context(kind, width, height)
        self._gl.make_current()
        self._scene, model = scene, scene.model
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._drawn = mujoco.MjvScene(model, 1000)
        self._option, self._nothing = mujoco.MjvOption(), mujoco.MjvPerturb()
        self._camera = mujoco.MjvCamera()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        self._context.free()
        self._gl.free()

    def refresh(self) -> None:
        """Take over the tissue's present shape."""
        mujoco.mjr_uploadMesh(self._scene.model, self._context, self._scene.tissue_id)

    def picture(
        self, camera: Camera, width: int, height: int, shadow_reach: float
    ) -> NDArray[np.uint8]:
        """Return what a camera sees, ``(height, width, 3)``.

        Args:
            camera: see there; its opening is that of the scene.
            width, height: [pixels].
            shadow_reach: how far around the middle of the cell things cast a shadow; the less,
                the finer its edge [m].
        """
        camera.place(self._camera)
        self._context.shadowClip = shadow_reach
        mujoco.mjv_updateScene(
            self._scene.model, self._scene.data, self._option, self._nothing, self._camera,
            mujoco.mjtCatBit.mjCAT_ALL.value, self._drawn,
        )  # fmt: skip
        frame = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(frame, self._drawn, self._context)
        pixels = np.empty((height, width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, frame, self._context)
        return pixels[::-1]


def _context(kind: str, width: int, height: int) -> Any:
    os.environ.pop(_PLATFORM, None)  # MuJoCo would rather give up than change it
    if kind == "egl":
        from mujoco.egl import GLContext  # noqa: PLC0415 - each binds OpenGL for the process
    else:
        from mujoco.osmesa import GLContext  # noqa: PLC0415
    return GLContext(width, height)
