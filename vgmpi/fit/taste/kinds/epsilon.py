"""Models that guess the noise itself, or v: UNet3DConditionModel, of TextToVideoSDPipeline."""

from typing import Any

from ..distilled import Level
from ..folder import ModelError, Part
from ..kind import BYTES, FLOAT, Kind, by_picture, coarser

SCHEDULERS = (
    "DDIMScheduler", "DDPMScheduler", "PNDMScheduler", "DPMSolverMultistepScheduler",
    "EulerDiscreteScheduler", "LMSDiscreteScheduler",
)  # fmt: skip
FILMS = 20  # as many numbers as this times a layer of the widest resolution are there at a time


class Epsilon(Kind):
    denoiser = "UNet3DConditionModel"
    coders = ("AutoencoderKL",)

    def __init__(self, folder, asked):
        super().__init__(folder, asked)
        self.levels = folder.plain("scheduler", SCHEDULERS, "scheduler_config.json")
        self.guesses = self.levels.config.get("prediction_type", "epsilon")
        if self.guesses not in ("epsilon", "v_prediction"):
            raise ModelError(f"its scheduler has the prediction_type '{self.guesses}'")
        folder.plain("tokenizer", ("CLIPTokenizer", "CLIPTokenizerFast"), None)

    def reader(self) -> Part:
        return self.folder.part("text_encoder", ("CLIPTextModel",))

    def step(self) -> int:
        return unet_step(self.denoises, self.codes)

    def busy(self, count: int, width: int, height: int) -> float:
        return unet(self.denoises, self.codes, BYTES[self.asked.precision], count, width * height)

    def load(self, device: str, image: Any) -> None:
        import diffusers

        super().load(device, image)
        made = diffusers.DDPMScheduler.from_config(self.levels.config)
        self.kept = made.alphas_cumprod.double()  # of the variance, by the step of time

    def read(self, image: Any) -> tuple[Any, Any]:
        """As the pipeline's encode_prompt: texts to the tokenizer's full length."""
        import torch
        import transformers

        made = getattr(transformers, self.folder.parts["tokenizer"], transformers.CLIPTokenizer)
        words = made.from_pretrained(self.folder.path / "tokenizer", local_files_only=True)
        reading = self.reading()
        longest = min(words.model_max_length, self.reads.config["max_position_embeddings"])

        def one(text: str) -> Any:
            ids = words(
                text, padding="max_length", max_length=longest, truncation=True, return_tensors="pt"
            ).input_ids
            return reading(ids.to(self.device))[0].to(self.dtype)

        with torch.no_grad():
            return one(self.asked.negative_prompt), one(str(self.asked.prompt))

    def level(self, share: float) -> Level:
        step = min(int(share * len(self.kept)), len(self.kept) - 1)
        kept = float(self.kept[step])
        return Level(kept**0.5, (1 - kept) ** 0.5, step)

    def encode(self, film: Any) -> Any:
        return by_picture(self.vae, film)

    def guess(self, z_t: Any, level: Level, condition: Any) -> Any:
        import torch

        time = torch.tensor([int(level.time)], device=z_t.device)
        told = self.model(z_t.to(self.dtype), time, encoder_hidden_states=condition).sample
        if self.guesses == "v_prediction":  # v = a eps - s z (Salimans and Ho 2022)
            return level.signal * told.to(z_t.dtype) + level.noise * z_t
        return told.to(z_t.dtype)


def unet_step(denoises: Part, codes: Part) -> int:
    """Pixels of which width and height are multiples, of a U-net on a coder of single pictures."""
    blocks = len(denoises.config.get("block_out_channels", (0, 0, 0, 0)))
    return coarser(codes) * 2 ** (blocks - 1)


def unet(denoises: Part, codes: Part, each: int, count: int, pixels: int) -> float:
    """Bytes that a U-net, or a coder of single pictures, takes beside its weights, about."""
    first = denoises.config.get("block_out_channels", [320])[0]
    inner = FILMS * first * count * pixels / coarser(codes) ** 2
    return max(inner * each, 8 * codes.config.get("block_out_channels", [128])[0] * pixels * FLOAT)
