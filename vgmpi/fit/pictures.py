"""Runs as pictures: what the renderer makes of their files, before it is rounded."""

from pathlib import Path

import numpy as np

from postprocess import settings
from postprocess.painter import Painter
from postprocess.video import VideoError
from postprocess.viewpoints import Viewpoint

from ..output.read import RunError, RunFiles

SHOWN = 640  # pixels of the longer side of what is there to be looked at


class Pictures:
    """A render.toml of one camera, by which all runs are drawn alike; as on paper where it says no
    look.preset. longest: pixels of the longer side at most. Raises
    postprocess.settings.SettingsError."""

    def __init__(self, path: Path, longest: int | None = None):
        self.path, self.longest = path, longest
        self.chosen = settings.load(path).on_paper()
        if len(self.chosen.views()) > 1:
            raise self._wrong("camera: several cameras; a fit looks through one")
        if self.chosen.background == "none":
            raise self._wrong("picture.background: 'none' is not compared: give a colour")

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [pixels] of what is drawn."""
        view = Viewpoint(
            self.chosen.views()[0], self.chosen.picture, self._box, self.path.parent, self.longest
        )
        return view.width, view.height

    def frames(self, count: int) -> list[int]:
        """Numbers of the frames that are drawn, of a run that has so many."""
        return self.chosen.frames.numbers(count)

    def of(self, folder: Path, frames: list[int]) -> np.ndarray:
        """Pictures of these frames of a run, (frames, height, width, 3) of 0..1. Raises RunError,
        SettingsError."""
        run = RunFiles(folder)
        drawn = self.frames(len(run))  # along which a camera goes its way
        parts = {index: k / max(len(drawn) - 1, 1) for k, index in enumerate(drawn)}
        try:
            painter = Painter(
                run, self.chosen, self.path.parent, longest=self.longest, box=self._box
            )
            found = [painter.pixels_of(k, parts.get(k, 0.0))[0][0] for k in frames]
        except VideoError as error:
            raise RunError(str(error)) from None
        return np.stack(found)

    def _box(self):
        """What is left out of a camera is chosen by where things are in a run: not the same for two
        of them."""
        said = "give eye and target (of an orbit target and distance), and liquid.clear: what is"
        raise self._wrong(f"camera: {said} left out follows the run, another way in each")

    def _wrong(self, said: str) -> settings.SettingsError:
        return settings.SettingsError([f"{self.path}: {said}"])
