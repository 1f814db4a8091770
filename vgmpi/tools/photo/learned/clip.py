"""Material guesses by CLIP: words compared with the crop of an object."""

from typing import Any

import numpy as np

from . import model_loading

DEFAULT_WEIGHTS = "openai/clip-vit-base-patch32"
NORMALIZATION = ((0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711))
BACKGROUND_LEVEL = 255  # transparent pixels of a crop become white


class Clip:
    """CLIP model and tokenizer of transformers."""

    def __init__(self, model: Any, tokenizer: Any):
        self.model, self.tokenizer = model, tokenizer
        self.size = int(model.config.vision_config.image_size)

    def ranked(self, crop: np.ndarray, words: list[str]) -> list[tuple[str, float]]:
        """Return words with their probabilities, the best first.

        crop: square, (n, n, 4) uint8.
        """
        torch, _ = model_loading.require_transformers()
        alpha = crop[..., 3:].astype(np.float64) / 255
        rgb = (crop[..., :3] * alpha + BACKGROUND_LEVEL * (1 - alpha) + 0.5).astype(np.uint8)
        device = next(self.model.parameters()).device
        image = model_loading.pixels(rgb, self.size, self.size, NORMALIZATION, sharp=True)
        texts = self.tokenizer(
            [f"a photo of a {word}" for word in words], padding=True, return_tensors="pt"
        )
        with torch.no_grad():
            output = self.model(
                input_ids=texts["input_ids"].to(device),
                attention_mask=texts["attention_mask"].to(device),
                pixel_values=torch.from_numpy(image).to(device),
            )
        shares = output.logits_per_image[0].softmax(dim=-1).cpu().numpy()
        return [(words[k], float(shares[k])) for k in np.argsort(-shares)]


def load(weights: str) -> Clip:
    """Load CLIP.

    Raises:
        LearnedError: The weights cannot be loaded.
    """
    _, transformers = model_loading.require_transformers()
    model = model_loading.load_model("CLIPModel", weights, ("clip",))
    with model_loading.as_learned_error(weights):
        tokenizer = transformers.CLIPTokenizer.from_pretrained(weights)
    return Clip(model, tokenizer)
