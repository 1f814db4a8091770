"""Tiny random models are saved, loaded and asked by the code that loads the real ones: shapes, the
scaling of prompts and the order of axes against known answers."""

import json
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support import drawn_photograph, tiny_image_models
from tests.support.launch import ROOT
from vgmpi.tools.photo import grabcut
from vgmpi.tools.photo.__main__ import main
from vgmpi.tools.photo.grabcut import Box
from vgmpi.tools.photo.learned import clip, depth, model_loading, sam
from vgmpi.tools.photo.learned.model_loading import LearnedError

torch = pytest.importorskip("torch", reason="no PyTorch: pip install 'vgmpi[learned]'")
transformers = pytest.importorskip(
    "transformers", reason="no transformers: pip install 'vgmpi[learned]'"
)
HEIGHT, WIDTH = 120, 160
BOX = Box(20, 30, 80, 90)
KINDS = ("sam", "sam2", "sam3")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Weights of a kind in a folder."""
    held = tmp_path_factory.mktemp("weights")

    def of(kind):
        path = held / kind
        return path if path.exists() else tiny_image_models.saved(kind, path)

    return of


@pytest.fixture(autouse=True)
def offline(monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")


def picture():
    """Red in its left quarter, green in its lower third; (120, 160, 3) uint8."""
    rgb = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    rgb[:, : WIDTH // 4, 0] = 255
    rgb[2 * HEIGHT // 3 :, :, 1] = 255
    return rgb


class Draws:
    """In place of a model: its masks are what its prompts say, in its own pixels; keeps what it is
    asked."""

    def __init__(self, size, fine):
        self.config = SimpleNamespace(prompt_encoder_config=SimpleNamespace(image_size=size))
        self.size, self.fine = size, fine  # of its pictures and of its masks

    def parameters(self):
        return iter([torch.zeros(1)])

    def __call__(self, pixel_values, multimask_output, input_boxes=None, input_points=None, **more):
        self.inputs = {"pixel_values": pixel_values, "boxes": input_boxes, "points": input_points}
        self.inputs |= more
        count = (input_boxes if input_boxes is not None else input_points).shape[1]
        at = (torch.arange(self.fine) + 0.5) * self.size / self.fine
        y, x = torch.meshgrid(at, at, indexing="ij")
        drawn = torch.full((1, count, 3, self.fine, self.fine), -1.0)
        for k in range(count):
            if input_boxes is not None:
                left, top, right, bottom = input_boxes[0, k]
                held = (x > left) & (x < right) & (y > top) & (y < bottom)
            else:
                cx, cy = input_points[0, k, 0]
                held = (x - cx) ** 2 + (y - cy) ** 2 < (self.size / 8) ** 2
            drawn[0, k, 1][held] = 1.0  # the second of three masks is the one
        scores = torch.tensor([0.2, 0.9, 0.4]).expand(1, count, 3)
        return SimpleNamespace(pred_masks=drawn, iou_scores=scores)


@pytest.mark.parametrize("kind", KINDS)
def test_a_mask_lies_where_the_box_is(kind):
    """Both ways of the scaling: a model that fills the box it is given fills the picture's."""
    model = Draws(128, 64)
    found = sam.Sam(model, sam.KINDS[kind])(picture(), BOX, [])
    wanted = np.zeros((HEIGHT, WIDTH), bool)
    wanted[BOX.top : BOX.bottom, BOX.left : BOX.right] = True
    score = grabcut.iou(found, wanted)
    print(f"{kind}: {score:.3f}")
    assert score > 0.93
    # 160 x 120 into 128 x 128: by .8 both ways where the shape is kept, else by .8 and 16 / 15
    tall = 0.8 if kind == "sam" else 128 / 120
    boxes = model.inputs["boxes"]
    assert boxes.shape == (1, 1, 4)
    assert torch.allclose(boxes[0, 0], torch.tensor([16.0, 30 * tall, 64.0, 90 * tall]))


@pytest.mark.parametrize("kind", KINDS)
def test_points_are_scaled_and_told_apart(kind):
    model = Draws(128, 64)
    sam.Sam(model, sam.KINDS[kind])(picture(), None, [(40, 60, True), (100, 20, False)])
    tall = 0.8 if kind == "sam" else 128 / 120
    wanted = torch.tensor([[[[32.0, 60 * tall], [80.0, 20 * tall]]]])
    assert torch.allclose(model.inputs["points"], wanted)
    assert model.inputs["input_labels"].tolist() == [[[1, 0]]]


@pytest.mark.parametrize("kind", KINDS)
def test_pixels_have_their_channels_rows_and_means(kind):
    model = Draws(128, 64)
    sam.Sam(model, sam.KINDS[kind])(picture(), BOX, [])
    pixels = model.inputs["pixel_values"]
    assert pixels.shape == (1, 3, 128, 128) and pixels.dtype == torch.float32
    mean, std = np.array(sam.KINDS[kind].look)
    rows = 96 if kind == "sam" else 128
    high = (1 - mean) / std
    low = -mean / std
    assert np.allclose(pixels[0, :, 5, 5], [high[0], low[1], low[2]], atol=1e-5)  # red, upper left
    assert np.allclose(pixels[0, :, 5, 100], low, atol=1e-5)
    assert np.allclose(pixels[0, :, rows - 5, 100], [low[0], high[1], low[2]], atol=1e-5)
    if kind == "sam":
        assert (pixels[0, :, 96:] == 0).all()


def test_pixels_of_sam_are_those_of_its_own_processor():
    own = transformers.SamImageProcessorPil(
        size={"longest_edge": 128}, pad_size={"height": 128, "width": 128}
    )
    wanted = own(picture(), return_tensors="np")["pixel_values"]
    model = Draws(128, 64)
    sam.Sam(model, sam.KINDS["sam"])(picture(), BOX, [])
    assert np.abs(wanted - model.inputs["pixel_values"].numpy()).max() < 0.02


@pytest.mark.parametrize("kind", KINDS)
def test_random_models_are_loaded_and_asked(folder, kind):
    one = sam.load(kind, str(folder(kind)))
    assert one.size == tiny_image_models.SIZES[kind]
    assert sum(p.numel() for p in one.model.parameters()) < 1e6
    rgb = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    boxes = [BOX, Box(90, 20, 150, 100)]
    found, scores = one.ask(rgb, boxes, [[], []], [[], []])
    assert found.shape == (2, HEIGHT, WIDTH) and found.dtype == bool and scores.shape == (2,)
    clicked, _ = one.ask(rgb, boxes[:1], [[[40.0, 50.0]]], [[1]])
    assert clicked.shape == (1, HEIGHT, WIDTH)
    again, _ = one.ask(rgb, boxes, [[], []], [[], []])
    assert (again == found).all()


@pytest.mark.parametrize("kind", KINDS)
def test_weights_survive_being_saved(folder, kind):
    """What is loaded answers as what was saved: none of its weights is random."""
    torch.manual_seed(0)
    made = {
        "sam": tiny_image_models.sam,
        "sam2": tiny_image_models.sam2,
        "sam3": tiny_image_models.sam3,
    }[kind]
    direct = sam.Sam(made(transformers).eval(), sam.KINDS[kind])
    torch.manual_seed(99)
    loaded = sam.load(kind, str(folder(kind)))
    rgb = picture()
    ours, theirs = (one.ask(rgb, [BOX], [[]], [[]]) for one in (loaded, direct))
    assert np.allclose(ours[1], theirs[1], atol=1e-5) and (ours[0] == theirs[0]).mean() > 0.999


def test_proposals_are_boxes_each_once():
    model = Draws(128, 64)
    boxes = sam.Sam(model, sam.KINDS["sam2"]).propose(picture())
    assert model.inputs["points"].shape == (1, sam.GRID_POINTS**2, 1, 2)
    assert len(boxes) > 4
    found = np.zeros((len(boxes), HEIGHT, WIDTH), bool)
    for one, box in zip(found, boxes):
        one[box.top : box.bottom, box.left : box.right] = True
    assert max(grabcut.iou(a, b) for k, a in enumerate(found) for b in found[:k]) < 0.8


def test_clip_ranks_as_its_own_parts_do(folder):
    one = clip.load(str(folder("clip")))
    crop = np.dstack([picture()[:, :HEIGHT], np.full((HEIGHT, HEIGHT), 255, np.uint8)])
    ranks = one.ranked(crop, tiny_image_models.WORDS)
    own = transformers.CLIPImageProcessorPil(
        size={"shortest_edge": 64}, crop_size={"height": 64, "width": 64}
    )
    shown = torch.from_numpy(own(crop[..., :3], return_tensors="np")["pixel_values"])
    logits = []
    with torch.no_grad():
        seen = one.model.visual_projection(one.model.vision_model(shown).pooler_output)
        for word in tiny_image_models.WORDS:
            told = one.tokenizer([f"a photo of a {word}"], return_tensors="pt")
            said = one.model.text_projection(one.model.text_model(**told).pooler_output)
            cosine = torch.nn.functional.cosine_similarity(seen, said)
            logits.append(float(cosine * one.model.logit_scale.exp()))
    shares = np.exp(logits) / np.exp(logits).sum()
    order = np.argsort(-shares)
    assert [word for word, _ in ranks] == [tiny_image_models.WORDS[k] for k in order]
    assert np.allclose([share for _, share in ranks], shares[order], atol=2e-3)


def test_clip_sees_the_object_before_white(folder):
    one = clip.load(str(folder("clip")))
    clear = np.dstack([picture()[:, :HEIGHT], np.zeros((HEIGHT, HEIGHT), np.uint8)])
    white = np.full((HEIGHT, HEIGHT, 4), 255, np.uint8)
    assert one.ranked(clear, tiny_image_models.WORDS) == one.ranked(white, tiny_image_models.WORDS)


@pytest.mark.parametrize("shape", [(120, 160), (480, 640), (300, 200), (64, 64)])
def test_pictures_for_depths_have_the_size_of_its_own_processor(folder, shape):
    one = depth.load(str(folder("depth")))
    assert (one.patch, one.side) == (14, 70)
    own = transformers.DPTImageProcessorPil(
        size={"height": 70, "width": 70}, keep_aspect_ratio=True, ensure_multiple_of=14,
        image_mean=model_loading.IMAGENET[0], image_std=model_loading.IMAGENET[1],
    )  # fmt: skip
    rgb = np.random.default_rng(0).integers(0, 255, (*shape, 3)).astype(np.uint8)
    wanted = own(rgb, return_tensors="np")["pixel_values"]
    rows, columns = one.size(*shape)
    assert wanted.shape == (1, 3, rows, columns)


def test_depths_come_back_in_the_picture_s_axes(folder):
    one = depth.load(str(folder("depth")))
    found = one.nearness(picture())
    assert found.shape == (HEIGHT, WIDTH) and np.isfinite(found).all()

    class Slope:  # in place of the model: nearer and nearer towards the lower rows
        config = one.model.config

        def parameters(self):
            return one.model.parameters()

        def __call__(self, pixel_values):
            rows, columns = pixel_values.shape[-2:]
            slope = torch.arange(rows).float()[None, :, None].expand(1, rows, columns)
            return SimpleNamespace(predicted_depth=slope + 1)

    near = depth.Depth(Slope(), 70).nearness(picture())
    assert (np.diff(near[:, 0]) >= 0).all() and near[-1, 0] > near[0, 0] + 10
    assert np.ptp(near, axis=1).max() < 1e-4
    far = depth.Depth(Slope(), 70)
    far.metric = True  # then it tells depths, and what is nearer has less of them
    assert np.allclose(far.nearness(picture()), 1 / near, rtol=1e-5)


def test_the_command_goes_the_whole_way_with_them(folder, tmp_path, monkeypatch, capsys):
    """SAM in place of GrabCut, CLIP in place of the table; masks are random, but of some pixels."""
    photo, layout = drawn_photograph.put(tmp_path)
    head = f'[masks]\nmethod = "sam2"\nweights = "{folder("sam2")}"\n'
    head += f'[materials]\nmethod = "clip"\nweights = "{folder("clip")}"\n'
    layout.write_text(drawn_photograph.layout(head=head).replace('reconstruction = "revolve"', ""))
    truth = iter(drawn_photograph.three().masks)
    asked = []

    def call(self, rgb, box, points, text=None):
        asked.append(self.ask(rgb, [box], [[]], [[]])[0].shape)
        return next(truth)  # what random weights say is no object

    monkeypatch.setattr(sam.Sam, "__call__", call)
    assert main([str(photo), str(layout), "-o", str(tmp_path / "out")]) == 0, capsys.readouterr()
    assert asked == [(1, 480, 640)] * 3
    assert layout.read_text().count("looks like") == 3


WRONG = {
    "nothing there": (lambda held: held / "none", "no such folder, and not to be had"),
    "an empty folder": (lambda held: held, "holds no weights that can be read"),
    "of another model": (None, "are weights of 'clip', not of sam2"),
}


@pytest.mark.parametrize("name", WRONG)
def test_weights_that_are_none_are_one_line(folder, tmp_path, capsys, name):
    make, needle = WRONG[name]
    where = folder("clip") if make is None else make(tmp_path)
    photo, layout = drawn_photograph.put(tmp_path)
    layout.write_text(
        drawn_photograph.layout(head=f'[masks]\nmethod = "sam2"\nweights = "{where}"\n')
    )
    assert main([str(photo), str(layout), "-o", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "layout.toml:1: masks: " in line and needle in line
    assert not (tmp_path / "out").exists()


def test_gated_weights_name_the_page_to_ask_at():
    error = OSError("You are trying to access a gated repo.\nMake sure to have access to it")
    said = model_loading.error_line("facebook/sam3", error)
    assert said == (
        "facebook/sam3: is gated: ask for it at https://huggingface.co/facebook/sam3, then"
        " `hf auth login`"
    )


def test_what_is_cut_off_is_told(folder, tmp_path):
    """Half of the weights: not taken for whole ones."""
    held = tiny_image_models.saved("sam", tmp_path / "sam")
    path = held / "model.safetensors"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(LearnedError, match="holds no weights that can be read"):
        sam.load("sam", str(held))


def test_configurations_are_read_by_their_type(folder):
    for kind in KINDS:
        told = json.loads((folder(kind) / "config.json").read_text())["model_type"]
        assert told.startswith(sam.KINDS[kind].types)
        others = [one for one in KINDS if one != kind]
        assert not any(told == t for one in others for t in sam.KINDS[one].types)


def test_this_process_is_not_the_one_without_them():
    """The message where the packages are missing is of tests/tools/test_photo_missing.py."""
    code = "import vgmpi.tools.photo.pipeline, sys; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0
