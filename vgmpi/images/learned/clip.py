"""What an object looks like it is made of, by CLIP: names of things against its crop."""

from typing import Any

import numpy as np

from vgmpi.images.learned import loading

USUAL = "openai/clip-vit-base-patch32"
LOOK = ((0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711))
BEHIND = 255  # what is transparent in a crop is white


class Clip:
    """model, tokenizer: as transformers has them."""

    def __init__(self, model: Any, tokenizer: Any):
        self.model, self.tokenizer = model, tokenizer
        self.size = int(model.config.vision_config.image_size)

    def ranked(self, crop: np.ndarray, words: list[str]) -> list[tuple[str, float]]:
        """Words with their shares of 1, the best first. crop: square, (n, n, 4) uint8."""
        torch, _ = loading.tools()
        alpha = crop[..., 3:].astype(np.float64) / 255
        rgb = (crop[..., :3] * alpha + BEHIND * (1 - alpha) + 0.5).astype(np.uint8)
        device = next(self.model.parameters()).device
        shown = loading.pixels(rgb, self.size, self.size, LOOK, sharp=True)
        texts = self.tokenizer(
            [f"a photo of a {word}" for word in words], padding=True, return_tensors="pt"
        )
        with torch.no_grad():
            told = self.model(
                input_ids=texts["input_ids"].to(device),
                attention_mask=texts["attention_mask"].to(device),
                pixel_values=torch.from_numpy(shown).to(device),
            )
        shares = told.logits_per_image[0].softmax(dim=-1).cpu().numpy()
        return [(words[k], float(shares[k])) for k in np.argsort(-shares)]


def load(weights: str) -> Clip:
    """Raises LearnedError."""
    _, transformers = loading.tools()
    model = loading.model("CLIPModel", weights, ("clip",))
    with loading.told(weights):
        tokenizer = transformers.CLIPTokenizer.from_pretrained(weights)
    return Clip(model, tokenizer)
