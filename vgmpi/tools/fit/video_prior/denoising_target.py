"""Target made of a video model: denoising loss, latent and gradient of runs."""

import contextlib
import functools
import hashlib
import importlib.metadata
import importlib.util
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from vgmpi.runtime import process_limits, user_files
from vgmpi.runtime.user_files import replace_file
from vgmpi.tools.fit.fit_config import FitFile
from vgmpi.tools.fit.run_pool import RECORD
from vgmpi.tools.fit.target_base import Pictures, Target
from vgmpi.tools.fit.video_reader import same_aspect
from vgmpi.tools.tradeoff.study_runs import StudyError

from . import score_distillation
from .model_base import VideoModel, kind_of
from .model_folder import ModelError
from .sds_config import Sds

PACKAGES = ("torch", "diffusers", "transformers", "accelerate")


class DenoisingTarget(Target):
    """Denoising loss of runs under a video model.

    The residual has one entry per noise sample, the rms error of the predicted noise; the mean
    square of the entries is the denoising loss. Results are cached in the folder of a run.
    """

    def __init__(self, file: FitFile, kind: VideoModel | None = None):
        """Check the table [sds] without loading the model.

        Args:
            file: The fit file.
            kind: Model to use in place of the one in the model folder.

        Raises:
            FitFileError: If the table does not suit the model or the scene.
            vgmpi.postprocess.frames.render_config.SettingsError: If render.toml is wrong.
            StudyError: If packages are missing.
        """
        super().__init__()
        assert file.settings.sds is not None
        self.file, self.options = file, file.settings.sds
        self.loss_description = (
            "root of the mean square of what the model's guess of the noise is off by"
        )
        self.needs_gradient = file.settings.method.algorithm == "descent"
        self.is_injected, self.loaded = kind is not None, kind is not None
        self.kind = kind or self._model()
        self.renderer = Pictures(file.folder / self.options.render)
        self.size = self.options.size or self.renderer.size
        self.numbers = self._frames()
        self.picture = self._read_image() if self.kind.by == "image" else None
        if not self.is_injected:
            self._check_size()
            _require_packages()
            self.preamble = self._require_model_memory()
        self.values = [np.zeros(self.options.noise_samples)]
        self.holdout_mask = [np.zeros(self.options.noise_samples, bool)]

    def _model(self) -> VideoModel:
        """Return the model in the folder, not loaded. Raises FitFileError."""
        try:
            model = kind_of(self.file.folder / self.options.model, self.options)
        except ModelError as error:
            message = f"{error}; got '{self.options.model}'"
            raise self.file.wrong(("sds", "model"), message) from None
        if getattr(self.options, model.by) is None:
            other = "image" if model.by == "prompt" else "prompt"
            message = f"{model.denoiser} goes by {model.by}, not by {other}"
            raise self.file.wrong(("sds", other), message)
        return model

    def _frames(self) -> list[int]:
        """Return the numbers of the frames shown to the model."""
        drawn = self.renderer.frames(self.file.scene.time.frames)
        count = self.options.frames or len(drawn)
        if not 1 <= count <= len(drawn):
            message = f"{len(drawn)} frames of the scene are drawn; got {count}"
            raise self.file.wrong(("sds", "frames"), message)
        wrong = self.kind.wrong_count(count)
        if wrong:
            raise self.file.wrong(("sds", "frames"), wrong)
        return [drawn[k] for k in np.linspace(0, len(drawn) - 1, count).round().astype(int)]

    def _check_size(self) -> None:
        """Refuse a size that the model cannot process or of another aspect ratio."""
        step = self.kind.step()
        wrong = [x for x in self.size if x % step]
        if wrong:
            message = f"{wrong[0]} pixels are no multiple of {step}, which the model needs"
            where = ("sds", "size") if self.options.size else ("sds", "render")
            raise self.file.wrong(where, f"{message}: give size, or render.toml another")
        if not same_aspect(self.size, self.renderer.size):
            message = (
                f"is of another shape than what is drawn, {_size_text(self.renderer.size)} pixels"
            )
            raise self.file.wrong(("sds", "size"), f"{message}; got {_size_text(self.size)}")

    def _read_image(self) -> np.ndarray:
        """Return the first picture, (height, width, 3) in [0, 1], in the model's size."""
        from PIL import Image

        path = self.file.folder / str(self.options.image)
        try:
            raw = np.atleast_3d(user_files.read_image(path))
            if raw.dtype != np.uint8 or raw.shape[2] not in (1, 3, 4):
                raise ValueError("neither a grey nor a color picture of 8 bits")
            if not same_aspect(raw.shape[1::-1], self.size):
                message = f"is of another shape, {_size_text(raw.shape[1::-1])} pixels"
                raise ValueError(f"{message}, than the {_size_text(self.size)} of the rest")
        except ValueError as error:
            message = f"{error}; got '{self.options.image}'"
            raise self.file.wrong(("sds", "image"), message) from None
        rgb = np.repeat(raw, 3, 2) if raw.shape[2] == 1 else raw[..., :3]
        resized = Image.fromarray(rgb).resize(self.size, Image.Resampling.BICUBIC)
        return np.asarray(resized, np.float32) / 255

    def _require_model_memory(self) -> str:
        """Return the memory estimate; raise FitFileError if it exceeds the free memory."""
        required = self.kind.required_bytes(len(self.numbers), *self.size)
        what = f"{self.kind.denoiser} in {self.options.precision} takes about"
        try:
            if _device(self.options) == "cpu":
                process_limits.require_memory(required, what)
            else:
                _check_gpu_memory(required, what)
        except process_limits.InsufficientMemoryError as error:
            raise self.file.wrong(("sds", "model"), str(error)) from None
        frames_text = f"{len(self.numbers)} frames of {_size_text(self.size)} pixels"
        memory = process_limits.format_bytes(required)
        return f"{what} {memory} of memory on {_device(self.options)}, for {frames_text}"

    @functools.cached_property
    def key(self) -> str:
        """Hash of everything besides the run that cached results depend on."""
        stamp: dict[str, Any] = {"sds": self.options.model_dump(), "frames": self.numbers}
        stamp["render"] = (self.file.folder / self.options.render).read_text()
        if not self.is_injected:
            stamp["model"], stamp["device"] = self.kind.folder.stamp(), _device(self.options)
            stamp["by"] = [importlib.metadata.version(name) for name in PACKAGES]
        if self.picture is not None:
            stamp["image"] = hashlib.sha256(self.picture.tobytes()).hexdigest()
        return hashlib.sha256(json.dumps(stamp, sort_keys=True).encode()).hexdigest()

    def observe(self, folder: Path, stage: int) -> np.ndarray:
        """Return the rms error of each noise sample, shape (noise samples,)."""
        return self._query(folder, "loss")

    def sds_gradient(self, folder: Path) -> np.ndarray:
        """Return the score distillation gradient of a run's latent, shape (n,)."""
        return self._query(folder, "pull")

    def _query(self, folder: Path, name: str) -> np.ndarray:
        """Return a result for a run, from the cache or from the model."""
        cached = self._load_cached(folder, name)
        if cached is None:
            self._query_model(folder)
            cached = self._load_cached(folder, name)
        return np.asarray(cached)

    def code(self, folder: Path) -> np.ndarray:
        """Return the latent of a run, shape (1, channels, frames, height, width)."""
        latent = self._load_cached(folder, "code")
        if latent is None:
            images = self.renderer.render_run(folder, self.numbers)
            with self._loaded_model() as torch, torch.no_grad():
                film = self.to_model_video(images).to(self.kind.device)
                latent = self.kind.encode(film).float().cpu().numpy()
            self._store_cached(folder, "code", latent)
        return latent

    def _query_model(self, folder: Path) -> None:
        """Evaluate the model for every noise sample and cache the results.

        Samples are processed one after the other, which takes the least memory.
        """
        latent = self.code(folder)
        losses, gradient = [], np.zeros(latent.shape, np.float32)
        with self._loaded_model() as torch, torch.no_grad():
            z = torch.from_numpy(latent).to(self.kind.device)
            for sample in self._draws(z.shape):
                if self.needs_gradient:
                    contribution, loss = score_distillation.sds_gradient(
                        self.kind, z, sample, self.guidance
                    )
                    gradient += contribution.float().cpu().numpy() / np.float32(
                        self.options.noise_samples
                    )
                else:
                    loss = score_distillation.denoising_loss(self.kind, z, sample)
                losses.append(loss**0.5)
        self._store_cached(folder, "loss", np.array(losses))
        if self.needs_gradient:
            self._store_cached(folder, "pull", gradient.ravel())

    @property
    def guidance(self) -> float:
        """Guidance scale."""
        scale = self.options.guidance_scale
        return self.kind.default_guidance if scale is None else scale

    def _draws(self, shape: tuple[int, ...]) -> Iterator[score_distillation.NoiseSample]:
        """Yield the noise samples, the same ones for every run."""
        for k, share in enumerate(
            score_distillation.stratified_levels(
                self.options.noise_levels, self.options.noise_samples
            )
        ):
            level = self.kind.level(share)
            yield score_distillation.draw(
                level, tuple(shape), self.options.seed, k, self.kind.device
            )

    def to_model_video(self, pictures: np.ndarray) -> Any:
        """Convert images to the input of the model.

        Args:
            pictures: Images, shape (frames, height, width, 3) in [0, 1].

        Returns:
            Tensor (1, 3, frames, height, width) in [-1, 1], in the model's size.
        """
        import torch

        film = torch.from_numpy(pictures.astype(np.float32)).permute(3, 0, 1, 2)
        width, height = self.size
        if tuple(film.shape[2:]) != (height, width):
            interpolation = {"mode": "bilinear", "align_corners": False, "antialias": True}
            film = torch.nn.functional.interpolate(film, (height, width), **interpolation)
        return film[None] * 2 - 1

    @contextlib.contextmanager
    def _loaded_model(self) -> Iterator[Any]:
        """Provide torch with the model loaded; report failures in one line."""
        import torch

        try:
            if not self.loaded:
                self._load()
            yield torch
        except (OSError, ValueError, RuntimeError, KeyError, TypeError, ImportError) as error:
            lines = [line.strip() for line in str(error).splitlines() if line.strip()]
            message = (lines or [type(error).__name__])[0][:200]
            raise self.file.wrong(("sds", "model"), f"cannot be asked: {message}") from None

    def _load(self) -> None:
        """Load the model."""
        import diffusers
        import transformers

        for package in (diffusers.utils.logging, transformers.logging):
            package.set_verbosity_error()
            package.disable_progress_bar()
        image = None if self.picture is None else self.to_model_video(self.picture[None])[:, :, 0]
        self.kind.load(_device(self.options), image)
        self.loaded = True

    def _cache_path(self, folder: Path, name: str) -> Path:
        """Return the path of a cached result."""
        return folder / f"sds_{name}.npz"

    def _cache_key(self, folder: Path) -> str:
        """Return the cache key, which includes the record of the run."""
        record = (folder / RECORD).read_bytes() if (folder / RECORD).exists() else b""
        return hashlib.sha256(self.key.encode() + record).hexdigest()

    def _load_cached(self, folder: Path, name: str) -> np.ndarray | None:
        """Return a cached result, or None."""
        try:
            with np.load(self._cache_path(folder, name), allow_pickle=False) as archive:
                return (
                    archive["numbers"] if str(archive["key"]) == self._cache_key(folder) else None
                )
        except (
            Exception
        ):  # missing or truncated; zip, zlib and numpy raise exceptions of many classes
            return None

    def _store_cached(self, folder: Path, name: str, numbers: np.ndarray) -> None:
        """Store a result atomically; processes that share a fit write identical files."""
        content = io.BytesIO()
        np.savez(content, numbers=numbers, key=self._cache_key(folder))
        replace_file(self._cache_path(folder, name), content.getvalue())


def _size_text(size: tuple[int, ...]) -> str:
    """Return width x height as a text."""
    return f"{size[0]} x {size[1]}"


def _require_packages() -> None:
    """Raise StudyError if a package is missing."""
    missing = [name for name in PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        message = f"[sds] needs {', '.join(missing)}"
        raise StudyError(f"{message}: pip install 'vgmpi[sds]'")


@functools.cache
def _has_gpu() -> bool:
    """Return whether torch has a GPU."""
    import torch

    return torch.cuda.is_available()


def _device(options: Sds) -> str:
    """Return the device of the model."""
    return options.device if options.device != "auto" else "cuda" if _has_gpu() else "cpu"


def _check_gpu_memory(required: float, what: str) -> None:
    """Raise TooLarge if the free GPU memory is too small."""
    import torch

    free = torch.cuda.mem_get_info()[0] if _has_gpu() else 0
    if required > free:
        raise process_limits.InsufficientMemoryError(
            f"{what} {process_limits.format_bytes(required)};"
            f" {process_limits.format_bytes(free)} are free on the card"
        )
