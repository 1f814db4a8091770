"""A view of the live page, drawn by the renderer in a process of its own.

The renderer compiles and computes for seconds; in another process it does not hold up the page, and
its errors end nothing else.
"""

import concurrent.futures
import logging
import multiprocessing
import os
import signal
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import numpy as np

from vgmpi.io.run_reader import RunError, RunReader

from ..frames import render_config
from ..frames.frame_renderer import draw_preview
from .saved_camera import View

PICTURE_SIZE = 800  # [pixels] longer side of a picture
LOW_PRIORITY = 10  # of the process, so that a run on the same machine goes first

log = logging.getLogger("vgmpi")


class ViewRenderer:
    """Process that draws one view at a time."""

    def __init__(self) -> None:
        """Start nothing; the process starts with the first picture."""
        self._pool: concurrent.futures.ProcessPoolExecutor | None = None
        self._picture: concurrent.futures.Future | None = None

    @property
    def is_busy(self) -> bool:
        """Return whether a picture is being drawn."""
        return self._picture is not None

    def start(self, folder: Path, settings: Path | None, number: int, view: View) -> None:
        """Begin a picture.

        Args:
            folder: Folder of the run.
            settings: File render.toml, or None.
            number: Number of the frame.
            view: View to draw.
        """
        if self._pool is None:
            context = multiprocessing.get_context("spawn")  # forked ones would share open files
            self._pool = concurrent.futures.ProcessPoolExecutor(1, context, _prepare_process)
        self._picture = self._pool.submit(_draw, folder, settings, number, view)

    def poll(self) -> tuple[np.ndarray | None, str] | None:
        """Return a picture, uint8 (height, width, 3), and "", or None and why there is none.

        Returns:
            None while the picture is drawn, or if none was begun.
        """
        if self._picture is None or not self._picture.done():
            return None
        picture, self._picture = self._picture, None
        try:
            return picture.result()
        except BrokenProcessPool:
            self._pool = None
            return None, "the renderer's process has ended: perhaps the memory is too small"
        except Exception as error:  # a fault of the renderer; the page goes on
            log.error("the renderer failed: %r", error)
            return None, f"the renderer failed: {error!r}"

    def close(self) -> None:
        """End the process."""
        if self._pool is None:
            return
        processes = list((self._pool._processes or {}).values())
        self._pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:  # it may draw for a long time yet
            process.terminate()
        self._pool = None


def settings_of_view(settings: render_config.Settings, view: View) -> render_config.Settings:
    """Return settings with a view as the only camera, and a picture of its shape."""
    width = PICTURE_SIZE if view.aspect >= 1 else round(PICTURE_SIZE * view.aspect)
    height = PICTURE_SIZE if view.aspect < 1 else round(PICTURE_SIZE / view.aspect)
    size = {"width": max(width, 16), "height": max(height, 16)}
    picture = settings.picture.model_copy(update=size)
    return settings.model_copy(update={"camera": (view.settings(),), "picture": picture})


def _prepare_process() -> None:
    """Leave Ctrl-C to the page, and the processor to a run."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(LOW_PRIORITY)
    logging.disable(logging.WARNING)


def _draw(
    folder: Path, settings: Path | None, number: int, view: View
) -> tuple[np.ndarray | None, str]:
    """Draw a view; see ViewRenderer.poll."""
    try:
        chosen = settings_of_view(render_config.load(settings), view)
        base = render_config.base_folder(settings)
        picture = draw_preview(RunReader(folder), chosen, base, number, PICTURE_SIZE)
        return np.ascontiguousarray(picture[..., :3]), ""
    except (RunError, render_config.SettingsError) as error:
        lines = render_config.error_lines(error, settings)
        return None, lines[0]
