"""Films of motions: an animated GIF, or an MP4 where there is FFmpeg."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from reports.parts.style import PAPER

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure

SUFFIXES = (".gif", ".mp4")
FPS, PIXELS = 25, 640
"""Pictures per second, and the width of a picture, if nothing else is said."""
BITRATE = 2000
"""Of an MP4 [kbit/s]."""


@contextmanager
def film(figure: Figure, path: Path, fps: int, pixels: int) -> Iterator[Callable[[], None]]:
    """A film of a figure; each call of what is handed out takes a picture of it.

    pixels : width of a picture

    Raises ValueError for another suffix, or numbers that are not positive, and ImportError for an
    MP4 where there is no FFmpeg.
    """
    import matplotlib as mpl

    if not (fps > 0 and pixels > 0):
        raise ValueError(f"fps = {fps} and {pixels} pixels must be positive")
    made, settings = writer_of(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context(settings):
        writer = made(fps=fps)
        with writer.saving(figure, str(path), dpi=pixels / figure.get_figwidth()):
            # pictures of a GIF lie on top of one another: each needs its own ground
            yield lambda: writer.grab_frame(facecolor=PAPER)


def writer_of(path: Path) -> tuple[Callable[..., Any], Any]:
    """What writes a film, and the settings of matplotlib that it needs.

    Raises ValueError for another suffix, and ImportError for an MP4 where there is no FFmpeg.
    """
    from matplotlib.animation import FFMpegWriter, PillowWriter

    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(f"{path.name}: a film is written as {' or '.join(SUFFIXES)}")
    if suffix == ".gif":
        return PillowWriter, {}
    return partial(FFMpegWriter, bitrate=BITRATE), {"animation.ffmpeg_path": ffmpeg()}


def ffmpeg() -> str:
    """The program, of the system or of the package imageio-ffmpeg.

    Raises ImportError, with the remedy, where there is neither.
    """
    found = shutil.which("ffmpeg")
    if found is not None:
        return found
    try:
        import imageio_ffmpeg
    except ImportError:
        raise ImportError("an .mp4 needs FFmpeg, of the system or of the extra [film]; "
                          "a .gif needs nothing") from None  # fmt: skip
    return str(imageio_ffmpeg.get_ffmpeg_exe())
