"""``pulsempc render``: a film or a still of a run."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from bench.progress import Reporter
from scenarios.film import Wish, render

_arg = tyro.conf.arg


@dataclass(frozen=True)
class Render:
    """Draw a run: both arms, the contact, its forces; as .mp4, .gif or .png.

    For example, `pulsempc render runs/seed3 --out film.mp4 --from 2 --to 6 --speed 0.25`, or
    `pulsempc render runs/seed3 --out still.png --from 2.3`. Nothing is simulated again.
    """

    run_folder: Annotated[tyro.conf.Positional[Path], _arg(metavar="RUN")]
    """Folder that `pulsempc run` has written."""
    out: Annotated[Path, _arg(metavar="FILE")]
    """What to write, a new file; the end of its name says of which kind."""
    fps: Annotated[float | None, _arg(metavar="N")] = None
    """Frames a second; 25 if not given."""
    speed: Annotated[float | None, _arg(metavar="X")] = None
    """Simulated seconds a second of the film; below 1 is slow motion."""
    start: Annotated[float | None, _arg(name="from", metavar="S")] = None
    """First instant, or that of a still (the middle of the run if not given) [s]."""
    end: Annotated[float | None, _arg(name="to", metavar="S")] = None
    """Last instant [s]."""
    size: Annotated[str | None, _arg(metavar="WxH")] = None
    """Width and height; 1280x720 if not given, 960x540 for a .gif; taller ones have the forces
    below."""
    camera: Annotated[str | None, _arg(metavar="NAME")] = None
    """Where to look from: overview (if not given), front, left, right, above, back."""

    def run(self) -> int:
        """Draw and write; return the exit code."""
        wish = Wish(self.out, self.fps, self.speed, self.start, self.end, self.size, self.camera)
        with Reporter(quiet=False) as reporter:
            render(self.run_folder, wish, reporter)
        print(f"film: {self.out}")
        return 0
