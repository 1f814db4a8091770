"""Models whose denoiser is a U-net on an encoder of single pictures.

Noise- and v-prediction: UNet3DConditionModel of TextToVideoSDPipeline. v-prediction at unbounded
noise levels (Karras et al. 2022, EDM): UNetSpatioTemporalConditionModel of
StableVideoDiffusionPipeline, conditioned on a first picture.
"""

import json
import math
from typing import Any

from vgmpi.tools.fit.video_prior.model_base import (
    BYTES_BY_PRECISION,
    FLOAT_BYTES,
    VideoModel,
    encode_by_picture,
    latent_downsampling,
)
from vgmpi.tools.fit.video_prior.model_folder import ModelError, Part
from vgmpi.tools.fit.video_prior.score_distillation import Level, draw

SCHEDULERS = (
    "DDIMScheduler", "DDPMScheduler", "PNDMScheduler", "DPMSolverMultistepScheduler",
    "EulerDiscreteScheduler", "LMSDiscreteScheduler",
)  # fmt: skip
ACTIVATION_FACTOR = 20  # activations alive at a time, in layers of the finest resolution
IMAGE_NOISE = 0.02  # [-] noise that the pipeline adds to the first picture
# mean, std
CLIP_STATISTICS = ((0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711))


class Epsilon(VideoModel):
    """Text-to-video model that predicts the noise or v."""

    denoiser = "UNet3DConditionModel"
    coders = ("AutoencoderKL",)

    def __init__(self, folder, options):
        super().__init__(folder, options)
        self.levels = folder.plain("scheduler", SCHEDULERS, "scheduler_config.json")
        self.prediction_type = self.levels.config.get("prediction_type", "epsilon")
        if self.prediction_type not in ("epsilon", "v_prediction"):
            raise ModelError(f"its scheduler has the prediction_type '{self.prediction_type}'")
        folder.plain("tokenizer", ("CLIPTokenizer", "CLIPTokenizerFast"), None)

    def reader(self) -> Part:
        """Return the text encoder."""
        return self.folder.part("text_encoder", ("CLIPTextModel",))

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
        return unet_bytes(
            self.denoises,
            self.codes,
            BYTES_BY_PRECISION[self.options.precision],
            count,
            width * height,
        )

    def load(self, device: str, image: Any) -> None:
        """Load the weights and the noise schedule."""
        import diffusers

        super().load(device, image)
        scheduler = diffusers.DDPMScheduler.from_config(self.levels.config)
        # share of the signal in the variance, by time step
        self.alphas_cumprod = scheduler.alphas_cumprod.double()

    def read(self, image: Any) -> tuple[Any, Any]:
        """Return the embeddings without and with the prompt.

        They follow encode_prompt of the pipeline: texts padded to the tokenizer's full length.
        """
        import torch
        import transformers

        tokenizer_class = getattr(
            transformers, self.folder.parts["tokenizer"], transformers.CLIPTokenizer
        )
        tokenizer = tokenizer_class.from_pretrained(
            self.folder.path / "tokenizer", local_files_only=True
        )
        reader = self.load_reader()
        max_length = min(tokenizer.model_max_length, self.reads.config["max_position_embeddings"])

        def embed(text: str) -> Any:
            """Return the embedding of a text."""
            ids = tokenizer(
                text,
                padding="max_length",
                max_length=max_length,
                truncation=True,
                return_tensors="pt",
            ).input_ids
            return reader(ids.to(self.device))[0].to(self.dtype)

        with torch.no_grad():
            return embed(self.options.negative_prompt), embed(str(self.options.prompt))

    def level(self, share: float) -> Level:
        """Return the noise level for a share in [0, 1]."""
        step = min(int(share * len(self.alphas_cumprod)), len(self.alphas_cumprod) - 1)
        signal_variance = float(self.alphas_cumprod[step])
        return Level(signal_variance**0.5, (1 - signal_variance) ** 0.5, step)

    def encode(self, film: Any) -> Any:
        """Return the latent of a film."""
        return encode_by_picture(self.vae, film)

    def predict(self, z_t: Any, level: Level, condition: Any) -> Any:
        """Return the predicted noise.

        Args:
            z_t: Noised latent.
            level: Its noise level.
            condition: Condition, one of `conditions`.
        """
        import torch

        time = torch.tensor([int(level.time)], device=z_t.device)
        output = self.model(z_t.to(self.dtype), time, encoder_hidden_states=condition).sample
        if self.prediction_type == "v_prediction":  # v = a eps - s z (Salimans and Ho 2022)
            return level.signal * output.to(z_t.dtype) + level.noise * z_t
        return output.to(z_t.dtype)


def unet_step(denoises: Part, codes: Part) -> int:
    """Return the number of pixels of which width and height must be multiples.

    It holds for a U-net on an encoder of single pictures.
    """
    blocks = len(denoises.config.get("block_out_channels", (0, 0, 0, 0)))
    return latent_downsampling(codes) * 2 ** (blocks - 1)


def unet_bytes(
    denoises: Part, codes: Part, bytes_per_number: int, count: int, pixels: int
) -> float:
    """Estimate the activations of a U-net or of an encoder of single pictures [bytes].

    Args:
        denoises: Component that predicts noise.
        codes: Component that encodes pictures.
        bytes_per_number: Size of a number [bytes].
        count: Number of frames.
        pixels: Pixels per frame.
    """
    channels = denoises.config.get("block_out_channels", [320])[0]
    activations = ACTIVATION_FACTOR * channels * count * pixels / latent_downsampling(codes) ** 2
    return max(
        activations * bytes_per_number,
        8 * codes.config.get("block_out_channels", [128])[0] * pixels * FLOAT_BYTES,
    )


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
