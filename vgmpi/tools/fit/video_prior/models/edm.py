"""Models with v-prediction at unbounded noise levels (Karras et al. 2022, EDM).

UNetSpatioTemporalConditionModel of StableVideoDiffusionPipeline, conditioned on a first picture.
"""

import json
import math
from typing import Any

from vgmpi.tools.fit.video_prior.model_base import BYTES_BY_PRECISION, VideoModel, encode_by_picture
from vgmpi.tools.fit.video_prior.model_folder import ModelError, Part
from vgmpi.tools.fit.video_prior.score_distillation import Level, draw

from .epsilon_prediction import unet_bytes, unet_step

IMAGE_NOISE = 0.02  # [-] noise that the pipeline adds to the first picture
# mean, std
CLIP_STATISTICS = ((0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711))


class Edm(VideoModel):
    """Image-to-video model with EDM noise levels."""

    denoiser = "UNetSpatioTemporalConditionModel"
    coders = ("AutoencoderKLTemporalDecoder", "AutoencoderKL")
    by = "image"
    default_guidance = 3.0

    def __init__(self, folder, options):
        super().__init__(folder, options)
        kinds = ("EulerDiscreteScheduler",)
        levels = folder.plain("scheduler", kinds, "scheduler_config.json").config
        if levels.get("prediction_type") != "v_prediction":
            prediction_type = levels.get("prediction_type")
            raise ModelError(
                f"its scheduler has the prediction_type '{prediction_type}', not v_prediction"
            )

    def reader(self) -> Part:
        """Return the image encoder."""
        return self.folder.part("image_encoder", ("CLIPVisionModelWithProjection",))

    def step(self) -> int:
        """Return the number of pixels of which width and height must be multiples."""
        return unet_step(self.denoises, self.codes)

    def activation_bytes(self, count: int, width: int, height: int) -> float:
        """Estimate the memory of activations [bytes].

        Args:
            count: Number of frames.
            width: Width of the frames [pixels].
            height: Height of the frames [pixels].
        """
        bytes_per_number = BYTES_BY_PRECISION[self.options.precision]
        return unet_bytes(self.denoises, self.codes, bytes_per_number, 2 * count, width * height)

    def read(self, image: Any) -> tuple[Any, Any]:
        """Return the conditions without and with the picture.

        Each is an embedding (1, 1, n) and an unscaled latent (1, channels, height, width) of the
        first picture. As in the pipeline both are 0 without the picture: with either of them, that
        half would know the picture too.
        """
        import torch

        with torch.no_grad():
            features = self.load_reader()(
                pixel_values=self._to_reader_input(image).to(self.device, self.dtype)
            )
            embedded = features.image_embeds[:, None]
            noise = draw(Level(1, 1, 0), tuple(image.shape), self.options.seed, 0xFFFF).eps
            noisy = (image + IMAGE_NOISE * noise).to(self.device)
            code = self.vae.encode(noisy).latent_dist.mode().to(self.dtype)
        return (torch.zeros_like(embedded), torch.zeros_like(code)), (embedded, code)

    def _to_reader_input(self, image: Any) -> Any:
        """Resize and normalize a picture for the image encoder, shape (1, 3, n, n)."""
        import torch

        file = self.folder.path / "feature_extractor" / "preprocessor_config.json"
        preprocessor = json.loads(file.read_text()) if file.is_file() else {}
        mean = torch.tensor(preprocessor.get("image_mean", CLIP_STATISTICS[0])).reshape(1, 3, 1, 1)
        spread = torch.tensor(preprocessor.get("image_std", CLIP_STATISTICS[1])).reshape(1, 3, 1, 1)
        side = (self.reads.config["image_size"],) * 2
        interpolation = {"mode": "bicubic", "align_corners": False, "antialias": True}
        resized = torch.nn.functional.interpolate(image, side, **interpolation)
        return ((resized + 1) / 2 - mean) / spread

    def level(self, share: float) -> Level:
        """Return the level with the ratio of noise to signal of flow matching at this share."""
        sigma = share / (1 - share)
        return Level(1.0, sigma, 0.25 * math.log(sigma))

    def encode(self, film: Any) -> Any:
        """Return the latent of a film."""
        return encode_by_picture(self.vae, film)

    def predict(self, z_t: Any, level: Level, condition: Any) -> Any:
        """Return the predicted noise.

        The clean latent is x0 = c_skip z_t + c_out v with c_skip = 1 / (sigma^2 + 1) and c_out =
        -sigma / sqrt(sigma^2 + 1), for data of unit variance (Karras et al. 2022, table 1).

        Args:
            z_t: Noised latent.
            level: Its noise level.
            condition: Condition, one of `conditions`.
        """
        import torch

        embedded, first = condition
        sigma, films = level.noise, z_t.transpose(1, 2)  # the model has frames before channels
        scaled = (films / (sigma**2 + 1) ** 0.5).to(self.dtype)
        model_input = torch.cat([scaled, first[:, None].expand(-1, films.shape[1], -1, -1, -1)], 2)
        output = self.model(
            model_input,
            torch.tensor([level.time], device=z_t.device, dtype=torch.float32),
            encoder_hidden_states=embedded,
            added_time_ids=torch.tensor(
                [[self.options.fps - 1, self.options.motion_bucket_id, IMAGE_NOISE]],
                device=z_t.device, dtype=self.dtype,
            ),
        ).sample.to(z_t.dtype)  # fmt: skip
        clean = films / (sigma**2 + 1) - sigma / (sigma**2 + 1) ** 0.5 * output
        return ((films - clean) / sigma).transpose(1, 2)
