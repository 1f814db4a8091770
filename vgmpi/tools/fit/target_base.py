"""Base class of targets: observed values and the subset that is held out."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.camera_paths import CameraPath
from vgmpi.postprocess.frames.frame_renderer import FrameRenderer
from vgmpi.postprocess.frames.image_io import VideoError
from vgmpi.scene.sections import Time

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


class Target:
    """Observed values to which a run is compared, in stages from coarse to fine.

    values: by stage, (n,). holdout_mask: by stage, (n,) bool, True if a value is not fitted.
    Residuals are relative to the magnitude of the target.
    """

    def __init__(self) -> None:
        self.preamble = ""  # text that is printed before any run
        self.values: list[np.ndarray] = []
        self.holdout_mask: list[np.ndarray] = []
        self.correlated_counts = [1.0]  # by stage: number of adjacent values with correlated errors
        self.loss_description = ""  # description of the loss for the report
        self.frames: list[int] = []  # numbers of the frames of a run that are compared
        self.pictures: Pictures | None = None  # renderer of runs for viewing, or None

    @property
    def stages(self) -> int:
        """Number of stages."""
        return len(self.values)

    def observe(self, folder: Path, stage: int) -> np.ndarray:
        """Return the values of a run, shape (n,). Raises RunError."""
        raise NotImplementedError

    def residual(self, folder: Path, stage: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the residuals of a run: of fitted values, and of held-out ones.

        The mean square of each is the squared loss.
        """
        residual, holdout_mask = (
            self.observe(folder, stage) - self.values[stage],
            self.holdout_mask[stage],
        )
        return residual[~holdout_mask], residual[holdout_mask]

    def images(self) -> np.ndarray:
        """Return images of the target at `frames`, shape (frames, height, width, 3) in [0, 1].

        They have the size that `pictures` draws. Raises RunError.
        """
        raise NotImplementedError

    def report_lines(self, folder: Path) -> list[str]:
        """Return further lines about a run for the report."""
        return []


def nearest_frames(
    time: Time, times: np.ndarray, candidates: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Find the frames of a scene that are nearest to given times.

    Args:
        time: Time settings of the scene.
        times: Times, shape (n,) [s].
        candidates: Numbers of the frames to choose from.

    Returns:
        Positions in `candidates`, shape (n,), and time differences, shape (n,) [frame intervals].
    """
    candidate_times = np.linspace(0, time.end, time.frames)[list(candidates)]
    nearest = np.abs(candidate_times[None, :] - times[:, None]).argmin(1)
    return nearest, np.abs(candidate_times[nearest] - times) * (time.frames - 1) / time.end


def held_out(number: np.ndarray, every: int) -> np.ndarray:
    """Return which of the numbered items are held out: one in `every`, never the first."""
    return number % every == every - 1 if every else np.zeros(len(number), bool)
