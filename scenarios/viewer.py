"""A running experiment in MuJoCo's own viewer, in a window."""

import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import glfw
import mujoco
import mujoco.viewer
import numpy as np

from plant.interface import Truth
from plant.own_arm import tool_arm
from qpmpc.step import Step
from scenarios.config import Scenario
from scenarios.errors import ScenarioError
from scenarios.experiment import Report, assemble
from scenarios.live import LiveSetpoint
from scenarios.log import Log
from scenarios.loop import Pace, Stop, control_loop
from scenarios.scene.arrows import force_arrow
from scenarios.scene.camera import VIEWS, around
from scenarios.scene.meshes import Array
from scenarios.scene.scene import FIELD_OF_VIEW, Scene

_REFRESH = 1.0 / 60.0
"""Time between two pictures, at least [s]."""
_PATIENCE = 10.0
"""How long the window may take to close [s]."""
_SCALE, _THICKNESS = 0.012, 0.004
"""Length by force of the rod that stands for it [m/N], and its radius [m]."""
_BLUE = np.array([0.34, 0.71, 0.91, 1.0], dtype=np.float32)


class NoDisplayError(ScenarioError):
    """There is no screen to open a window on."""

    def __init__(self) -> None:
        super().__init__(
            "no window can be opened here (a display with OpenGL is needed); "
            "pulsempc render draws a run without one"
        )


def view(
    scenario: Scenario, *, report: Report, stop: Stop, pace: Pace, waiting: Callable[[], None]
) -> Log:
    """Run a scenario under control and show it, until its end or until the window is closed.

    Args:
        scenario: see there.
        report, stop, pace: see `scenarios.loop`.
        waiting: called at the end of the run, when the window stays open.

    Raises:
        NoDisplayError: there is no screen. ScenarioError, QpmpcError, PlantError: what the
        scenario asks for cannot be had.
    """
    _check_display()
    made = assemble(scenario, report)
    scene = Scene(tool_arm(scenario.cell), 640, 480)
    latest = made.cell.truth()
    scene.pose(latest.joint_angle, latest.touching)

    def notice(_: Step) -> None:
        nonlocal latest
        latest = made.cell.truth()

    try:
        with _window(scene) as window, _drawing(window, scene, lambda: latest):
            over = control_loop(
                made.cell, made.controller, made.setpoint, made.log, scenario.cycles,
                schedule=made.schedule, watch=notice, pace=pace, progress=lambda _k, _n: None,
                stop=lambda: stop() or not window.is_running(),
            )  # fmt: skip
            if over:
                waiting()
            while over and window.is_running() and not stop():
                time.sleep(_REFRESH)
    finally:
        if isinstance(made.setpoint, LiveSetpoint):
            made.setpoint.close()
    return made.log


@contextmanager
def _window(scene: Scene) -> Iterator[Any]:
    """Open the viewer; at the end wait until it has gone, as the process must not end before."""
    others = set(threading.enumerate())
    with mujoco.viewer.launch_passive(
        scene.model, scene.data, show_left_ui=False, show_right_ui=False
    ) as window:
        camera = around(next(iter(VIEWS.values())), scene.corners(), FIELD_OF_VIEW, 1.5)
        with window.lock():
            camera.place(window.cam)
        yield window
    for thread in set(threading.enumerate()) - others:
        thread.join(_PATIENCE)


@contextmanager
def _drawing(window: Any, scene: Scene, latest: Callable[[], Truth]) -> Iterator[None]:
    """Show what is latest, again and again, in a thread that the control loop never waits for."""
    over = threading.Event()

    def draw() -> None:
        while not over.wait(_REFRESH) and window.is_running():
            truth = latest()
            with window.lock():
                contact = scene.pose(truth.joint_angle, truth.touching)
                _draw_force(window.user_scn, contact.tip, truth.force)
            window.update_mesh(scene.tissue_id)
            window.sync()

    thread = threading.Thread(target=draw, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(_PATIENCE)


def _draw_force(drawn: Any, at: Array, force: Array) -> None:
    arrow = force_arrow(at, force, _SCALE)
    drawn.ngeom = 0
    if arrow is None:
        return
    geom = drawn.geoms[0]
    # MuJoCo draws its own kind of arrow half as long as the connector says.
    kind = mujoco.mjtGeom.mjGEOM_CAPSULE
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), _BLUE)
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR  # which is left as it was found
    geom.objtype, geom.objid, geom.segid = mujoco.mjtObj.mjOBJ_UNKNOWN, -1, 0
    mujoco.mjv_connector(geom, kind, _THICKNESS, arrow.start, arrow.end)
    drawn.ngeom = 1


def _check_display() -> None:
    """Open a window that is not seen: the viewer itself would wait for ever.

    Raises:
        NoDisplayError: it cannot be opened.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # GLFW's own words for it
        window = None
        if glfw.init():
            glfw.window_hint(glfw.VISIBLE, False)
            window = glfw.create_window(64, 64, "pulsempc", None, None)
            if window:
                glfw.destroy_window(window)
            glfw.default_window_hints()
    if not window:
        raise NoDisplayError
