"""Target made of another run: the distribution of its bodies in its frames."""

from pathlib import Path

import numpy as np

from vgmpi.io.run_reader import RunError
from vgmpi.runtime.message_text import did_you_mean
from vgmpi.tools.tradeoff.error_measures import RunOutcome

from .fit_config import FitFile
from .run_renderer import MAX_DISPLAY_SIZE, Pictures
from .target_base import Target, held_out, nearest_frames

TIME_TOLERANCE = 1e-6  # [frame intervals]


class RunTarget(Target):
    """Share of each body's mass in the bins of a lattice, in frames of another run."""

    def __init__(self, file: FitFile):
        super().__init__()
        settings, self.scene = file.settings.target, file.scene
        self.loss_description = (
            "rms of what of a body is in another bin, over the rms of what is in them"
        )
        folder = file.folder / str(settings.run)
        body_names = {o.name for o in self.scene.object if o.role == "body"}
        wanted = settings.bodies or tuple(sorted(body_names))
        for k, name in enumerate(wanted):
            if name not in body_names:
                message = f"there is no body '{name}'{did_you_mean(name, body_names)}"
                raise file.wrong(
                    ("target", "bodies", k), f"{message}; known: {', '.join(body_names)}"
                )
        try:
            other = RunOutcome(folder)
            names = [o["name"] for o in other.run.objects]
            missing = [name for name in wanted if name not in names]
            if missing:
                raise RunError(f"has no body '{missing[0]}'; it has {', '.join(names)}")
            if not np.allclose(other.size, self.scene.domain.size, rtol=1e-9):
                size = " x ".join(f"{x:g}" for x in other.size)
                raise RunError(f"is of another domain, {size} m")
            self.wanted, self.times = wanted, other.times
            raw = [
                self._shares(other, bins, range(len(other.times))) for bins in settings.density_bins
            ]
        except RunError as error:
            raise file.wrong(("target", "run"), f"{error}; got '{settings.run}'") from None
        self.bins, self.correlated_counts = settings.density_bins, [1.0] * len(raw)
        self.unit = [float(np.sqrt(np.mean(shares**2))) for shares in raw]
        self.values = [shares.ravel() / unit for shares, unit in zip(raw, self.unit)]
        holdout = held_out(np.arange(len(self.times)), settings.holdout_every)
        self.holdout_mask = [np.repeat(holdout, shares[0].size) for shares in raw]
        self._check_times(file)
        self.other = folder
        if settings.render is not None:
            self.pictures = Pictures(file.folder / settings.render, MAX_DISPLAY_SIZE)

    def _check_times(self, file: FitFile) -> None:
        """Pair frames by their times. Raises FitFileError if one has no counterpart."""
        time = file.scene.time
        nearest, distance = nearest_frames(time, self.times, range(time.frames))
        is_unmatched = distance > TIME_TOLERANCE
        if is_unmatched.any():
            message = (
                f"has a frame at {self.times[is_unmatched][0]:g} s, of which the scene has none"
            )
            raise file.wrong(("target", "run"), f"{message}: its time.end and time.frames say when")
        self.frames = [int(k) for k in nearest]

    def images(self) -> np.ndarray:
        """Return images of the other run."""
        assert self.pictures is not None
        return self.pictures.render_run(self.other, list(range(len(self.times))))

    def _shares(self, outcome: RunOutcome, bins: int, frames) -> np.ndarray:
        """Return the share of each body's mass in bins, (frames, bodies, bins)."""
        names = [o["name"] for o in outcome.run.objects]
        rows = [names.index(name) for name in self.wanted]
        total = outcome.body_masses[rows]
        return np.stack(
            [outcome.mass_in_boxes(int(k), bins)[rows] / total[:, None] for k in frames]
        )

    def observe(self, folder: Path, stage: int) -> np.ndarray:
        """Return the scaled shares of a run in the bins of a stage, shape (n,)."""
        shares = self._shares(RunOutcome(folder), self.bins[stage], self.frames)
        return shares.ravel() / self.unit[stage]
