"""From the table [target] of a fit file to what runs are held to."""

from .bodies import Frames
from .measured import Measured
from .settings import FitFile
from .target import Target


def target_of(file: FitFile) -> Target:
    """Raises FitFileError."""
    return Frames(file) if file.settings.target.frames is not None else Measured(file)
