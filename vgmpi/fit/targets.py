"""From the table [target] of a fit file to what runs are held to."""

from .bodies import Frames
from .measured import Measured
from .settings import FitFile
from .target import Target
from .video import Video


def target_of(file: FitFile) -> Target:
    """Raises FitFileError; of a video also postprocess.settings.SettingsError."""
    asked = file.settings.target
    if asked.video is not None:
        return Video(file)
    return Frames(file) if asked.frames is not None else Measured(file)
