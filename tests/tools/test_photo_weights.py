"""Real weights of the learned models, where they lie: VGMPI_MODELS=FOLDER, a folder for each.

A model's folder has the last part of its name at Hugging Face, such as sam2.1-hiera-small. `-rP`
prints size, sha256, seconds of a processor and memory for the table of the how-to guide.
"""

import hashlib
import os
import time
from pathlib import Path

import numpy as np
import pytest

from tests.support import drawn_photograph, peak_memory
from vgmpi.tools.photo import grabcut, material_lookup, preview
from vgmpi.tools.photo.learned import clip, depth, sam

MODELS = os.environ.get("VGMPI_MODELS")


def weights(name):
    """The folder of a model's weights, or the test is skipped."""
    if not MODELS:
        pytest.skip("VGMPI_MODELS names no folder with real weights")
    folder = Path(MODELS) / name.rpartition("/")[2]
    if not folder.is_dir():
        pytest.skip(f"no weights in {folder}")
    pytest.importorskip("torch", reason="no PyTorch: pip install 'vgmpi[learned]'")
    pytest.importorskip("transformers", reason="no transformers: pip install 'vgmpi[learned]'")
    return folder


def measured(folder, load, ask):
    """What a model answers; prints what the table of the guide says about it."""
    for path in sorted(folder.glob("*.safetensors")) + sorted(folder.glob("*.bin")):
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        print(f"{path.name}: {path.stat().st_size / 1e6:.0f} MB, sha256 {digest}")
    peak_memory.forget()
    model = load(str(folder))
    begin = time.process_time()
    answer = ask(model)
    print(f"{folder.name}: {time.process_time() - begin:.1f} s of processor time,"
          f" {peak_memory.megabytes():.0f} MB")  # fmt: skip
    return answer


@pytest.mark.parametrize("kind", sam.KINDS)
def test_a_mask_is_that_of_the_object(kind):
    folder = weights(sam.KINDS[kind].default_weights)
    drawn = drawn_photograph.three()
    boxes = [grabcut.box_of(mask) for mask in drawn.masks]
    masks = measured(
        folder,
        lambda path: sam.load(kind, path),
        lambda model: [model(drawn.rgb, box, []) for box in boxes],
    )
    overlap = [grabcut.iou(a, b) for a, b in zip(masks, drawn.masks, strict=True)]
    print("IoU", np.round(overlap, 3))
    assert min(overlap) > 0.9


def test_the_floor_comes_nearer_towards_its_lower_edge():
    folder = weights(depth.DEFAULT_WEIGHTS)
    rgb = drawn_photograph.three().rgb
    near = measured(folder, depth.load, lambda model: model.nearness(rgb))
    assert near.shape == rgb.shape[:2]
    assert np.median(near[-20:]) > np.median(near[near.shape[0] // 2 :][:20])


def test_a_word_is_ranked_for_a_crop():
    folder = weights(clip.DEFAULT_WEIGHTS)
    drawn = drawn_photograph.three()
    crop = preview.crop(drawn.rgb, drawn.masks[drawn_photograph.NAMES.index("ball")])
    ranks = measured(folder, clip.load, lambda model: model.ranked(crop, material_lookup.words()))
    print(ranks[:5])
    assert "ball" in [word for word, _ in ranks[:5]]
