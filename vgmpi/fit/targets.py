"""From the table [target] of a fit file to what runs are held to."""

from .bodies import Frames
from .measured import Measured
from .settings import FitFile
from .target import Target
from .taste.liking import Taste
from .video import Video


def target_of(file: FitFile) -> Target:
    """Raises FitFileError; of pictures also postprocess.settings.SettingsError, of [sds] StudyError
    where packages are missing."""
    if file.settings.sds is not None:
        return Taste(file)
    asked = file.settings.target
    if asked.video is not None:
        return Video(file)
    return Frames(file) if asked.frames is not None else Measured(file)
