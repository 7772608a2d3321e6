"""Frames into a file: all of it, or none."""

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenarios.errors import ScenarioError
from scenarios.film.canvas import INTERFACE

Frame = NDArray[np.uint8]
"""``(height, width, 3)``"""


class Writer(Protocol):
    """Takes the frames of a film, one after the other."""

    def add(self, frame: Frame) -> None:
        """Append a frame."""
        ...

    def finish(self) -> None:
        """Complete the file."""
        ...

    def abandon(self) -> None:
        """Let go of the file, which is of no use."""
        ...


class FilmPackageError(ScenarioError):
    """What writes MP4 is not installed."""

    def __init__(self) -> None:
        super().__init__(
            "an .mp4 needs the package av: pip install 'pulsempc[film]'; .gif and .png do without"
        )


@contextmanager
def film_file(out: Path, fps: float, width: int, height: int) -> Iterator[Writer]:
    """Give a writer for the kind of file that the name's end says.

    The file appears under its name when all is well, and not before; nothing stays of one that
    was broken off.

    Raises:
        ScenarioError: it exists, its folder does not, it cannot be written, or what writes it is
        not installed.
    """
    make = _WRITERS[out.suffix.lower()]
    partial: Path | None = None
    try:
        if out.exists():
            raise ScenarioError(f"{out}: exists; give another --out")
        if not out.parent.is_dir():
            raise ScenarioError(f"{out.parent}: no such folder; give another --out")
        handle, name = tempfile.mkstemp(
            prefix=f".{out.stem[:40]}.", suffix=out.suffix.lower(), dir=out.parent
        )
        partial = Path(name)
        mask = os.umask(0)
        os.umask(mask)
        os.fchmod(handle, 0o666 & ~mask)
        os.close(handle)
        writer = make(partial, fps, width, height)
        try:
            yield writer
            writer.finish()
        except BaseException:
            writer.abandon()
            raise
        partial.replace(out)
        partial = None
    except OSError as error:
        raise ScenarioError(f"{out}: cannot be written: {error.strerror or error}") from None
    finally:
        if partial is not None:
            with suppress(OSError):
                partial.unlink()


class _Mp4:
    """H.264, as every player takes it."""

    def __init__(self, path: Path, fps: float, width: int, height: int) -> None:
        try:
            import av  # noqa: PLC0415 - not everyone has it
        except ImportError:
            raise FilmPackageError from None
        self._av = av
        self._file = av.open(str(path), "w", format="mp4", options={"movflags": "faststart"})
        self._stream = self._file.add_stream("libx264", rate=Fraction(fps).limit_denominator(1000))
        self._stream.width, self._stream.height = width, height
        self._stream.pix_fmt = "yuv420p"
        self._stream.options = {"crf": "18", "preset": "medium"}

    def add(self, frame: Frame) -> None:
        """Append a frame."""
        picture = self._av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
        self._file.mux(self._stream.encode(picture))

    def finish(self) -> None:
        """Complete the file."""
        self._file.mux(self._stream.encode())
        self._file.close()

    def abandon(self) -> None:
        """Let go of the file."""
        with suppress(Exception):
            self._file.close()


class _Gif:
    """One palette for all frames, so that nothing flickers."""

    def __init__(self, path: Path, fps: float, _width: int, _height: int) -> None:
        self._path, self._fps = path, fps
        self._palette: Image.Image | None = None
        self._frames: list[Image.Image] = []

    def add(self, frame: Frame) -> None:
        """Append a frame."""
        picture = Image.fromarray(frame)
        if self._palette is None:
            self._palette = _palette(picture)
        self._frames.append(
            picture.quantize(palette=self._palette, dither=Image.Dither.FLOYDSTEINBERG)
        )

    def finish(self) -> None:
        """Complete the file."""
        first, *others = self._frames
        first.save(
            self._path, format="GIF", save_all=True, append_images=others, loop=0,
            duration=durations(len(self._frames), self._fps), optimize=False,
        )  # fmt: skip

    def abandon(self) -> None:
        """Let go of the frames."""
        self._frames = []


def _palette(picture: Image.Image) -> Image.Image:
    """Return an image whose palette has the colours of a picture and those of what is written."""
    fixed = [channel for colour in INTERFACE for channel in colour[:3]]
    found = picture.quantize(256 - len(INTERFACE), method=Image.Quantize.MEDIANCUT).getpalette()
    holder = Image.new("P", (1, 1))
    holder.putpalette([*fixed, *(found or [])][:768])
    return holder


class _Png:
    """One picture."""

    def __init__(self, path: Path, _fps: float, _width: int, _height: int) -> None:
        self._path = path
        self._frame: Frame | None = None

    def add(self, frame: Frame) -> None:
        """Take the picture."""
        self._frame = frame

    def finish(self) -> None:
        """Write the file."""
        if self._frame is not None:
            Image.fromarray(self._frame).save(self._path, format="PNG", optimize=True)

    def abandon(self) -> None:
        """Let go of the picture."""


_WRITERS: Mapping[str, Callable[[Path, float, int, int], Writer]] = {
    ".mp4": _Mp4,
    ".gif": _Gif,
    ".png": _Png,
}


def durations(frames: int, fps: float) -> Sequence[int]:
    """How long each frame of a GIF is shown [ms].

    The format counts hundredths of a second; rounded so that the whole keeps its time.
    """
    ends = np.round(100.0 / fps * np.arange(1, frames + 1)).astype(int)
    return [10 * int(step) for step in np.diff(ends, prepend=0)]
