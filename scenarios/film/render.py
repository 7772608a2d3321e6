"""A film of a run: its pictures, one after the other, into a file."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from plant.own_arm import tool_arm
from scenarios.film.encode import Frame, film_file
from scenarios.film.layout import Box, lay_out
from scenarios.film.offscreen import Offscreen
from scenarios.film.overlay import Overlay, arrow_scale
from scenarios.film.plan import Plan, Wish, plan_film
from scenarios.film.plots import ForcePlots
from scenarios.film.record import Record, read_run
from scenarios.scene.camera import CLOSE, VIEWS, around, towards
from scenarios.scene.scene import FIELD_OF_VIEW, Scene

_CLOSE_HEIGHT = 0.125
"""What the close view shows at the contact, from top to bottom [m]."""
_SHADOWS, _CLOSE_SHADOWS = 1.0, 0.25
"""How far around the cell things cast a shadow, for the two views [m]."""
_FINENESS = {".mp4": 2048, ".gif": 2048, ".png": 4096}
"""Of shadows; a film of the finest takes half as long again."""

Progress = Callable[[str, int, int], None]
"""Called with the stage, frames done and frames in all."""


def render(folder: Path, wish: Wish, progress: Progress) -> None:
    """Draw the run of a folder into a file.

    Raises:
        ScenarioError: the folder holds no run, what is wished for cannot be, or nothing here
        draws without a screen; nothing has been written then.
    """
    record = read_run(folder)
    plan = plan_film(wish, record.start, record.end)
    with film_file(wish.out, plan.fps, plan.width, plan.height) as writer:
        for i, frame in enumerate(frames(record, plan)):
            progress("film", i, len(plan.instants))
            writer.add(frame)
        progress("film", len(plan.instants), len(plan.instants))


def frames(record: Record, plan: Plan) -> Iterator[Frame]:
    """Yield the pictures of a plan, each ``(height, width, 3)``.

    Raises:
        NoRendererError: nothing here draws without a screen.
    """
    layout = lay_out(plan.width, plan.height)
    view, close, unit = layout.view, layout.close, layout.unit
    width, height = max(view.width, close.width), max(view.height, close.height)
    scene = Scene(tool_arm(record.cell), width, height, shadows=_FINENESS[plan.kind])
    first = record.cycle(float(plan.instants[0]))
    last = record.cycle(float(plan.instants[-1]))
    scene.pose(record.angles[first], bool(record.touching[first]))
    overview = around(VIEWS[plan.camera], scene.corners(), FIELD_OF_VIEW, view.aspect)
    middle = np.median(record.tissue[first : last + 1], axis=0)
    detail = towards(
        CLOSE, middle - [0.0, 0.0, 0.10 * _CLOSE_HEIGHT], _CLOSE_HEIGHT, FIELD_OF_VIEW, close.aspect
    )
    distance = float((middle - overview.position) @ overview.forward)
    seen = 2.0 * distance * np.tan(np.deg2rad(FIELD_OF_VIEW) / 2.0)
    main = Overlay(record, overview, view, unit, arrow_scale(record, 0.16 * seen))
    near = Overlay(record, detail, close, unit, arrow_scale(record, 0.32 * _CLOSE_HEIGHT))
    plots = ForcePlots(
        record, layout.plots, unit, float(plan.instants[0]), float(plan.instants[-1])
    )
    with Offscreen(scene, width, height) as offscreen:
        for time in plan.instants.tolist():
            k = record.cycle(time)
            tip = scene.pose(record.angles[k], bool(record.touching[k])).tip
            offscreen.refresh()
            picture = Image.new("RGB", (plan.width, plan.height))
            for box, camera, over, reach in (
                (view, overview, main.main(time, tip, plan.speed), _SHADOWS),
                (close, detail, near.close(time, tip), _CLOSE_SHADOWS),
            ):
                seen_there = offscreen.picture(camera, box.width, box.height, reach)
                part = Image.fromarray(seen_there).convert("RGBA")
                picture.paste(Image.alpha_composite(part, over), _corner(box))
            picture.paste(plots.draw(time), _corner(layout.plots))
            yield np.asarray(picture)


def _corner(box: Box) -> tuple[int, int]:
    return box.left, box.top
