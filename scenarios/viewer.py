"""A running experiment in MuJoCo's own viewer, in a window."""

import time
import warnings
from collections.abc import Callable
from typing import Any

import glfw
import mujoco
import mujoco.viewer
import numpy as np

from plant.interface import Truth
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
"""Simulated time between two pictures [s]."""
_SCALE, _THICKNESS = 0.012, 0.006
"""Length by force of the arrow [m/N], and its radius [m]."""
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
    scene = Scene(scenario.cell, 640, 480)
    scene.pose(made.cell.truth().joint_angle, scenario.cell.contact.gap == 0)
    try:
        with mujoco.viewer.launch_passive(
            scene.model, scene.data, show_left_ui=False, show_right_ui=False
        ) as window:
            camera = around(next(iter(VIEWS.values())), scene.corners(), FIELD_OF_VIEW, 1.5)
            with window.lock():
                camera.place(window.cam)
            every = max(1, round(_REFRESH / scenario.cell.period))
            cycle = 0

            def show(_: Step) -> None:
                nonlocal cycle
                cycle += 1
                if cycle % every == 0:
                    _show(window, scene, made.cell.truth())

            over = control_loop(
                made.cell, made.controller, made.setpoint, made.log, scenario.cycles,
                schedule=made.schedule, watch=show, pace=pace, progress=lambda _k, _n: None,
                stop=lambda: stop() or not window.is_running(),
            )  # fmt: skip
            if over:
                waiting()
            while over and window.is_running() and not stop():
                time.sleep(0.05)
    finally:
        if isinstance(made.setpoint, LiveSetpoint):
            made.setpoint.close()
    return made.log


def _show(window: Any, scene: Scene, truth: Truth) -> None:
    with window.lock():
        contact = scene.pose(truth.joint_angle, truth.touching)
        _draw_arrow(window.user_scn, contact.tip, truth.force)
    window.update_mesh(scene.tissue_id)
    window.sync()


def _draw_arrow(drawn: Any, at: Array, force: Array) -> None:
    arrow = force_arrow(at, force, _SCALE)
    drawn.ngeom = 0
    if arrow is None:
        return
    geom = drawn.geoms[0]
    kind = mujoco.mjtGeom.mjGEOM_ARROW
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), _BLUE)
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
