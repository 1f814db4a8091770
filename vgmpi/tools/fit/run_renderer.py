"""Rendering of runs for comparison, before images are rounded to 8 bits."""

from pathlib import Path

import numpy as np

from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.camera_paths import CameraPath
from vgmpi.postprocess.frames.frame_renderer import FrameRenderer
from vgmpi.postprocess.frames.image_io import VideoError

MAX_DISPLAY_SIZE = 640  # [pixels] longer side of images made for viewing


class Pictures:
    """Renderer of runs through the single camera of a render.toml.

    All runs are drawn with the same settings, in the paper preset if look.preset is absent.
    """

    def __init__(self, path: Path, longest: int | None = None):
        """Load render.toml.

        Args:
            path: The render.toml.
            longest: Upper bound of the longer side [pixels].

        Raises:
            vgmpi.postprocess.frames.render_config.SettingsError: If the file is wrong or does not
                suit a comparison.
        """
        self.path, self.longest = path, longest
        self.chosen = render_config.load(path).on_paper()
        if len(self.chosen.views()) > 1:
            raise self._wrong("camera: several cameras; a fit looks through one")
        if self.chosen.background == "none":
            raise self._wrong("picture.background: 'none' is not compared: give a color")

    @property
    def size(self) -> tuple[int, int]:
        """Return width and height of the images [pixels]."""
        view = CameraPath(
            self.chosen.views()[0], self.chosen.picture, self._box, self.path.parent, self.longest
        )
        return view.width, view.height

    def frames(self, count: int) -> list[int]:
        """Return the numbers of the frames drawn from a run of `count` frames."""
        return self.chosen.frames.numbers(count)

    def render_run(self, folder: Path, frames: list[int]) -> np.ndarray:
        """Render frames of a run, shape (frames, height, width, 3) in [0, 1].

        Raises RunError, SettingsError.
        """
        run = RunReader(folder)
        drawn = self.frames(len(run))  # the camera path extends over these frames
        path_positions = {index: k / max(len(drawn) - 1, 1) for k, index in enumerate(drawn)}
        try:
            painter = FrameRenderer(
                run, self.chosen, self.path.parent, longest=self.longest, box=self._box
            )
            images = [painter.pixels_of(k, path_positions.get(k, 0.0))[0][0] for k in frames]
        except VideoError as error:
            raise RunError(str(error)) from None
        return np.stack(images)

    def _box(self):
        """Refuse a camera that is placed automatically.

        An automatic placement depends on the positions in a run, and so differs between two runs.
        """
        message = "give eye and target (of an orbit target and distance), and"
        message += " liquid.absorption_length: what is left out follows the run"
        raise self._wrong(f"camera: {message}, another way in each")

    def _wrong(self, message: str) -> render_config.SettingsError:
        return render_config.SettingsError([f"{self.path}: {message}"])
