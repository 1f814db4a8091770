"""Models that guess v at levels of noise without an end (Karras et al. 2022, EDM):
UNetSpatioTemporalConditionModel, of StableVideoDiffusionPipeline. They go by a first picture."""

import json
import math
from typing import Any

from ..distilled import Level, draw
from ..folder import ModelError, Part
from ..kind import BYTES, Kind, by_picture
from .epsilon import unet, unet_step

GRAIN = 0.02  # noise on the first picture, as the pipeline adds it
CLIP = ((0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711))


class Edm(Kind):
    denoiser = "UNetSpatioTemporalConditionModel"
    coders = ("AutoencoderKLTemporalDecoder", "AutoencoderKL")
    by = "image"
    usual = 3.0

    def __init__(self, folder, asked):
        super().__init__(folder, asked)
        kinds = ("EulerDiscreteScheduler",)
        levels = folder.plain("scheduler", kinds, "scheduler_config.json").config
        if levels.get("prediction_type") != "v_prediction":
            said = levels.get("prediction_type")
            raise ModelError(f"its scheduler has the prediction_type '{said}', not v_prediction")

    def reader(self) -> Part:
        return self.folder.part("image_encoder", ("CLIPVisionModelWithProjection",))

    def step(self) -> int:
        return unet_step(self.denoises, self.codes)

    def busy(self, count: int, width: int, height: int) -> float:
        each = BYTES[self.asked.precision]
        return unet(self.denoises, self.codes, each, 2 * count, width * height)

    def read(self, image: Any) -> tuple[Any, Any]:
        """Each condition is an embedding (1, 1, n) of the first picture and its code
        (1, channels, height, width), not scaled. Without it both are 0, as the pipeline has it: a
        half that was shown either would know the picture too."""
        import torch

        with torch.no_grad():
            seen = self.reading()(pixel_values=self._look(image).to(self.device, self.dtype))
            embedded = seen.image_embeds[:, None]
            grain = draw(Level(1, 1, 0), tuple(image.shape), self.asked.seed, 0xFFFF).eps
            noisy = (image + GRAIN * grain).to(self.device)
            code = self.vae.encode(noisy).latent_dist.mode().to(self.dtype)
        return (torch.zeros_like(embedded), torch.zeros_like(code)), (embedded, code)

    def _look(self, image: Any) -> Any:
        """The picture as its reader takes it: (1, 3, n, n)."""
        import torch

        file = self.folder.path / "feature_extractor" / "preprocessor_config.json"
        given = json.loads(file.read_text()) if file.is_file() else {}
        mean = torch.tensor(given.get("image_mean", CLIP[0])).reshape(1, 3, 1, 1)
        spread = torch.tensor(given.get("image_std", CLIP[1])).reshape(1, 3, 1, 1)
        side = (self.reads.config["image_size"],) * 2
        way = {"mode": "bicubic", "align_corners": False, "antialias": True}
        small = torch.nn.functional.interpolate(image, side, **way)
        return ((small + 1) / 2 - mean) / spread

    def level(self, share: float) -> Level:
        """The ratio of noise to signal is that of flow matching at the same share."""
        sigma = share / (1 - share)
        return Level(1.0, sigma, 0.25 * math.log(sigma))

    def encode(self, film: Any) -> Any:
        return by_picture(self.vae, film)

    def guess(self, z_t: Any, level: Level, condition: Any) -> Any:
        """By x0 = c_skip z_t + c_out v with c_skip = 1 / (sigma^2 + 1) and c_out = -sigma /
        sqrt(sigma^2 + 1), of data of spread 1 (Karras et al. 2022, table 1)."""
        import torch

        embedded, first = condition
        sigma, films = level.noise, z_t.transpose(1, 2)  # frames before channels
        scaled = (films / (sigma**2 + 1) ** 0.5).to(self.dtype)
        shown = torch.cat([scaled, first[:, None].expand(-1, films.shape[1], -1, -1, -1)], 2)
        told = self.model(
            shown,
            torch.tensor([level.time], device=z_t.device, dtype=torch.float32),
            encoder_hidden_states=embedded,
            added_time_ids=torch.tensor(
                [[self.asked.fps - 1, self.asked.motion, GRAIN]],
                device=z_t.device, dtype=self.dtype,
            ),
        ).sample.to(z_t.dtype)  # fmt: skip
        clean = films / (sigma**2 + 1) - sigma / (sigma**2 + 1) ** 0.5 * told
        return ((films - clean) / sigma).transpose(1, 2)
