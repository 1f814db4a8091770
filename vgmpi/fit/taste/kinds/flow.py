"""Models of flow matching (Lipman et al. 2023): WanTransformer3DModel, of WanPipeline."""

from typing import Any

from ..distilled import Level
from ..folder import ModelError, Part
from ..kind import BYTES, FLOAT, Kind

TOKENIZERS = ("T5TokenizerFast", "T5Tokenizer", "TokenizersBackend", "PreTrainedTokenizerFast")
WORDS = 512  # tokens of a prompt, as the pipeline has it
STEPS = 1000  # of time
LAYERS = 12  # as many numbers as this times a token's are there at a time


class Flow(Kind):
    part = "transformer"
    denoiser = "WanTransformer3DModel"
    coders = ("AutoencoderKLWan",)
    usual = 5.0

    def __init__(self, folder, asked):
        super().__init__(folder, asked)
        if "transformer_2" in folder.parts or folder.index.get("expand_timesteps"):
            raise ModelError("is a Wan 2.2 of two models, or of one time per token; 2.1 is known")
        folder.plain("tokenizer", TOKENIZERS, None)
        if self.denoises.config.get("image_dim"):
            raise ModelError("is a Wan that goes by a picture; those of a text are known")

    def reader(self) -> Part:
        return self.folder.part("text_encoder", ("UMT5EncoderModel",))

    def _coarser(self) -> int:
        return int(self.codes.config.get("scale_factor_spatial", 8))

    def step(self) -> int:
        return self._coarser() * int(self.denoises.config.get("patch_size", (1, 2, 2))[1])

    def wrong_count(self, count: int) -> str:
        each = int(self.codes.config.get("scale_factor_temporal", 4))
        if (count - 1) % each == 0:
            return ""
        near = max(1, (count - 1) // each * each + 1)
        return f"{count} frames, where it takes one more than a multiple of {each}, such as {near}"

    def busy(self, count: int, width: int, height: int) -> float:
        config = self.denoises.config
        inner = config.get("num_attention_heads", 40) * config.get("attention_head_dim", 128)
        each = int(self.codes.config.get("scale_factor_temporal", 4))
        tokens = ((count - 1) // each + 1) * width * height / self.step() ** 2
        coder = 40 * self.codes.config.get("base_dim", 96) * width * height * FLOAT
        hidden = (LAYERS * inner + config.get("ffn_dim", 4 * inner)) * tokens
        return max(hidden * BYTES[self.asked.precision], coder)

    def read(self, image: Any) -> tuple[Any, Any]:
        """As the pipeline's encode_prompt: of each text the tokens that it has, and 0 behind."""
        import torch
        import transformers

        words = transformers.AutoTokenizer.from_pretrained(
            self.folder.path / "tokenizer", local_files_only=True
        )
        reading = self.reading()

        def one(text: str) -> Any:
            asked = words(
                " ".join(text.split()), padding="max_length", max_length=WORDS, truncation=True,
                add_special_tokens=True, return_attention_mask=True, return_tensors="pt",
            ).to(self.device)  # fmt: skip
            states = reading(asked.input_ids, asked.attention_mask).last_hidden_state
            return (states * asked.attention_mask[..., None]).to(self.dtype)

        with torch.no_grad():
            return one(self.asked.negative_prompt), one(str(self.asked.prompt))

    def level(self, share: float) -> Level:
        return Level(1 - share, share, STEPS * share)

    def encode(self, film: Any) -> Any:
        import torch

        code, config = self.vae.encode(film).latent_dist.mode(), self.vae.config
        mean, spread = (
            torch.tensor(given, device=code.device, dtype=code.dtype).reshape(1, -1, 1, 1, 1)
            for given in (config.latents_mean, config.latents_std)
        )
        return (code - mean) / spread

    def guess(self, z_t: Any, level: Level, condition: Any) -> Any:
        """The model guesses v = eps - z, and eps = z_t + (1 - s) v."""
        import torch

        time = torch.tensor([level.time], device=z_t.device, dtype=torch.float32)
        told = self.model(z_t.to(self.dtype), time, encoder_hidden_states=condition).sample
        return z_t + level.signal * told.to(z_t.dtype)
