"""Flow-matching models (Lipman et al. 2023): WanTransformer3DModel of WanPipeline."""

from typing import Any

from vgmpi.tools.fit.video_prior.model_base import BYTES_BY_PRECISION, FLOAT_BYTES, VideoModel
from vgmpi.tools.fit.video_prior.model_folder import ModelError, Part
from vgmpi.tools.fit.video_prior.score_distillation import Level

TOKENIZERS = ("T5TokenizerFast", "T5Tokenizer", "TokenizersBackend", "PreTrainedTokenizerFast")
TOKENS = 512  # [tokens] length of a prompt in the pipeline
TIME_SCALE = 1000  # time steps of the model in the unit interval
ACTIVATION_FACTOR = 12  # activations alive at a time, in multiples of the hidden width


class Flow(VideoModel):
    """Text-to-video model of flow matching."""

    part = "transformer"
    denoiser = "WanTransformer3DModel"
    coders = ("AutoencoderKLWan",)
    default_guidance = 5.0

    def __init__(self, folder, options):
        super().__init__(folder, options)
        if "transformer_2" in folder.parts or folder.index.get("expand_timesteps"):
            raise ModelError("is a Wan 2.2 of two models, or of one time per token; 2.1 is known")
        folder.plain("tokenizer", TOKENIZERS, None)
        if self.denoises.config.get("image_dim"):
            raise ModelError("is a Wan that goes by a picture; those of a text are known")

    def reader(self) -> Part:
        """Return the text encoder."""
        return self.folder.part("text_encoder", ("UMT5EncoderModel",))

    def _latent_downsampling(self) -> int:
        """Return the pixels per latent entry along an edge."""
        return int(self.codes.config.get("scale_factor_spatial", 8))

    def step(self) -> int:
        """Return the number of pixels of which width and height must be multiples."""
        return self._latent_downsampling() * int(
            self.denoises.config.get("patch_size", (1, 2, 2))[1]
        )

    def wrong_count(self, count: int) -> str:
        """Return why so many frames cannot be processed, or ''."""
        stride = int(self.codes.config.get("scale_factor_temporal", 4))
        if (count - 1) % stride == 0:
            return ""
        valid = max(1, (count - 1) // stride * stride + 1)
        return (
            f"{count} frames, where it takes one more than a multiple of {stride}, such as {valid}"
        )

    def activation_bytes(self, count: int, width: int, height: int) -> float:
        """Estimate the memory of activations [bytes].

        Args:
            count: Number of frames.
            width: Width of the frames [pixels].
            height: Height of the frames [pixels].
        """
        config = self.denoises.config
        inner = config.get("num_attention_heads", 40) * config.get("attention_head_dim", 128)
        stride = int(self.codes.config.get("scale_factor_temporal", 4))
        tokens = ((count - 1) // stride + 1) * width * height / self.step() ** 2
        encoder = 40 * self.codes.config.get("base_dim", 96) * width * height * FLOAT_BYTES
        hidden = (ACTIVATION_FACTOR * inner + config.get("ffn_dim", 4 * inner)) * tokens
        return max(hidden * BYTES_BY_PRECISION[self.options.precision], encoder)

    def read(self, image: Any) -> tuple[Any, Any]:
        """Return the embeddings without and with the prompt.

        They follow encode_prompt of the pipeline: the tokens of each text, padded with zeros.
        """
        import torch
        import transformers

        tokenizer = transformers.AutoTokenizer.from_pretrained(
            self.folder.path / "tokenizer", local_files_only=True
        )
        reader = self.load_reader()

        def embed(text: str) -> Any:
            """Return the embedding of a text, padded with zeros."""
            tokens = tokenizer(
                " ".join(text.split()), padding="max_length", max_length=TOKENS, truncation=True,
                add_special_tokens=True, return_attention_mask=True, return_tensors="pt",
            ).to(self.device)  # fmt: skip
            states = reader(tokens.input_ids, tokens.attention_mask).last_hidden_state
            return (states * tokens.attention_mask[..., None]).to(self.dtype)

        with torch.no_grad():
            return embed(self.options.negative_prompt), embed(str(self.options.prompt))

    def level(self, share: float) -> Level:
        """Return the noise level for a share in [0, 1]."""
        return Level(1 - share, share, TIME_SCALE * share)

    def encode(self, film: Any) -> Any:
        """Return the normalized latent of a film."""
        import torch

        code, config = self.vae.encode(film).latent_dist.mode(), self.vae.config
        mean, spread = (
            torch.tensor(statistic, device=code.device, dtype=code.dtype).reshape(1, -1, 1, 1, 1)
            for statistic in (config.latents_mean, config.latents_std)
        )
        return (code - mean) / spread

    def predict(self, z_t: Any, level: Level, condition: Any) -> Any:
        """Return the noise eps = z_t + (1 - s) v; the model predicts v = eps - z.

        Args:
            z_t: Noised latent.
            level: Its noise level.
            condition: Condition, one of `conditions`.
        """
        import torch

        time = torch.tensor([level.time], device=z_t.device, dtype=torch.float32)
        output = self.model(z_t.to(self.dtype), time, encoder_hidden_states=condition).sample
        return z_t + level.signal * output.to(z_t.dtype)
