"""Choice of the target class by the tables [target] and [sds] of a fit file."""

from vgmpi.tools.fit.video_prior.denoising_target import DenoisingTarget

from .fit_config import FitFile
from .run_target import RunTarget
from .table_target import TableTarget
from .target_base import Target
from .video_target import VideoTarget


def target_of(file: FitFile) -> Target:
    """Return the target of a fit file.

    Raises:
        FitFileError: If the target does not suit the scene.
        vgmpi.postprocess.frames.render_config.SettingsError: If its render.toml is wrong.
        StudyError: If packages that [sds] needs are missing.
    """
    if file.settings.sds is not None:
        return DenoisingTarget(file)
    settings = file.settings.target
    if settings.video is not None:
        return VideoTarget(file)
    return RunTarget(file) if settings.run is not None else TableTarget(file)
