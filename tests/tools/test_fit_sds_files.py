"""Wrong [sds] of fit files, and models' folders that are not whole: each is refused with its line,
key and what is allowed, before anything is run or loaded."""

import json

import numpy as np
import pytest

from tests.support import sds_fits
from tests.support.fit_scenes import BALL, refused, write_fit
from vgmpi.postprocess.frames.image_io import write_png
from vgmpi.tools.fit import __main__ as fit
from vgmpi.tools.fit.video_prior import denoising_target
from vgmpi.tools.fit.video_prior.model_folder import Folder, ModelError

INDEX = {
    "_class_name": "WanPipeline",
    "scheduler": ["diffusers", "FlowMatchEulerDiscreteScheduler"],
    "text_encoder": ["transformers", "UMT5EncoderModel"],
    "tokenizer": ["transformers", "T5TokenizerFast"],
    "transformer": ["diffusers", "WanTransformer3DModel"],
    "vae": ["diffusers", "AutoencoderKLWan"],
}
HEAD = {"a": {"dtype": "F32", "shape": [2, 3], "data_offsets": [0, 24]}}


def weights(numbers=24):
    """A file of weights of six numbers, of so many bytes."""
    head = json.dumps(HEAD).encode()
    return len(head).to_bytes(8, "little") + head + bytes(numbers)


def whole(folder):
    """The files of a model that could be Wan's, as far as anyone looks before it is loaded."""
    for name in ("text_encoder", "transformer", "vae"):
        (folder / name).mkdir(parents=True, exist_ok=True)
        (folder / name / "config.json").write_text("{}")
        (folder / name / "model.safetensors").write_bytes(weights())
    (folder / "tokenizer").mkdir(exist_ok=True)
    (folder / "model_index.json").write_text(json.dumps(INDEX))
    return folder


@pytest.fixture
def beside(tmp_path):
    """A folder with a model and a render.toml."""
    whole(tmp_path / "model")
    sds_fits.rendered(tmp_path, 64)
    (tmp_path / "broken.png").write_text("no picture")
    write_png(tmp_path / "wide.png", np.zeros((60, 90, 3), np.uint8))
    return tmp_path


TEXT = sds_fits.sds(more="noise_samples = 4\nframes = 5", method="max_runs = 20")
TARGET = '[target]\ntable = "a.csv"\nprobe = "ball"\n'
# what is replaced, by what, the line and key told, what is said
WRONG = {
    "both": ("[sds]", TARGET + "[sds]", 9, "sds", "given at once: give exactly one of both"),
    "unknown key": (
        "noise_samples =", "noise_sample =", 10, "sds.noise_sample", "did you mean 'noise_samples'?"
    ),
    "no model": ('model = "model"\n', "", 6, "sds.model", "required key is missing: folder with"),
    "model of nothing": ('"model"', '" "', 7, "sds.model", "must say something"),
    "no such model": ('"model"', '"modle"', 7, "sds.model", "did you mean 'model'?"),
    "no render": ('render = "render.toml"\n', "", 6, "sds.render", "required key is missing"),
    "no prompt": (sds_fits.PROMPT, "", 6, "sds", "give exactly one of prompt, image"),
    "prompt and image": (
        sds_fits.PROMPT, f'{sds_fits.PROMPT}\nimage = "a.png"', 6, "sds",
        "both given: give exactly one"
    ),
    "prompt of nothing": (sds_fits.PROMPT, 'prompt = ""', 9, "sds.prompt", "must say something"),
    "an image for a text": (sds_fits.PROMPT, 'image = "a.png"', 9, "sds.image", "goes by prompt"),
    "the prompt against itself": (
        "noise_samples", 'negative_prompt = "a soft  ball bounces"\nnoise_samples', 6, "sds",
        "nothing to guide by",
    ),
    "a text for an image": (
        sds_fits.PROMPT, 'image = "a.png"\nnegative_prompt = "b"', 6, "sds", "no negative_prompt"
    ),
    "motion of a text": (
        "noise_samples", "motion_bucket_id = 3\nnoise_samples", 6, "sds",
        "there is no motion_bucket_id",
    ),
    "guidance backwards": (
        "noise_samples", "guidance_scale = -1\nnoise_samples", 10, "sds.guidance_scale",
        "equal to 0",
    ),
    "guidance in words": (
        "noise_samples", 'guidance_scale = "much"\nnoise_samples', 10, "sds.guidance_scale",
        "valid number",
    ),
    "no samples": (
        "noise_samples = 4", "noise_samples = 0", 10, "sds.noise_samples",
        "greater than or equal to 1",
    ),
    "a share of a sample": (
        "noise_samples = 4", "noise_samples = 2.5", 10, "sds.noise_samples", "valid integer",
    ),
    "levels of one": (
        "noise_samples", "noise_levels = [0.5]\nnoise_samples", 10, "sds.noise_levels",
        "too few values",
    ),
    "levels turned over": (
        "noise_samples", "noise_levels = [0.8, 0.2]\nnoise_samples", 10, "sds.noise_levels",
        "[least, most]",
    ),
    "no noise": (
        "noise_samples", "noise_levels = [0, 0.5]\nnoise_samples", 10, "sds.noise_levels.0",
        "greater than 0",
    ),
    "nothing but noise": (
        "noise_samples", "noise_levels = [0.5, 1]\nnoise_samples", 10, "sds.noise_levels.1",
        "less than 1",
    ),
    "a seed below 0": ("noise_samples", "seed = -1\nnoise_samples", 10, "sds.seed", "equal to 0"),
    "another precision": (
        "noise_samples", 'precision = "int8"\nnoise_samples', 10, "sds.precision",
        "float32, bfloat16, float16",
    ),
    "another device": (
        "noise_samples", 'device = "gpu"\nnoise_samples', 10, "sds.device", "auto, cpu, cuda",
    ),
    "a size of one number": (
        "noise_samples", "size = [64]\nnoise_samples", 10, "sds.size", "too few values",
    ),
    "a size too small": (
        "noise_samples", "size = [8, 64]\nnoise_samples", 10, "sds.size.0", "equal to 16",
    ),
    "a size between": (
        "noise_samples", "size = [64, 72]\nnoise_samples", 10, "sds.size",
        "72 pixels are no multiple of 16",
    ),
    "a size of another shape": (
        "noise_samples", "size = [64, 128]\nnoise_samples", 10, "sds.size",
        "another shape than what is drawn",
    ),
    "frames between": ("frames = 5", "frames = 6", 11, "sds.frames", "multiple of 4, such as 5"),
    "more frames than drawn": ("frames = 5", "frames = 9", 11, "sds.frames", "7 frames of the"),
    "frames between that are all": ("frames = 5\n", "", 6, "sds.frames", "7 frames, where it"),
    "least squares": (
        "max_runs = 20", 'algorithm = "least-squares"', 13, "method.algorithm",
        "must be one of descent, cma",
    ),
    "too few runs": (
        "max_runs = 20", "max_runs = 4", 13, "method.max_runs", "must be 5 or more for 1",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_file_is_told_by_its_line(beside, capsys, monkeypatch, name):
    monkeypatch.setattr(denoising_target, "PACKAGES", ())  # they come last
    monkeypatch.setattr(denoising_target, "_has_gpu", lambda: False)
    old, new, line, key, said = WRONG[name]
    assert TEXT.count(old) >= 1
    file, told = refused(capsys, beside, TEXT.replace(old, new, 1))
    assert told.startswith(f"{file}:{line}: {key}: ") and said in told, told
    assert not (beside / "fit" / "runs").exists()


def test_descent_without_a_model_is_refused(beside, capsys):
    text = sds_fits.PARAMETERS + TARGET + '[method]\nalgorithm = "descent"\n'
    file, told = refused(capsys, beside, text)
    assert f"{file}:10: method.algorithm: goes with [sds] alone" in told


def index(**changes):
    return lambda folder: (folder / "model_index.json").write_text(json.dumps(INDEX | changes))


def written(path, text):
    return lambda folder: (folder / path).write_text(text)


def shard(folder):
    """An index of weights that names a second file."""
    names = {"weight_map": {"a": "model.safetensors", "b": "model-2.safetensors"}}
    (folder / "transformer" / "model.safetensors.index.json").write_text(json.dumps(names))


# what is done to a model's folder, and what is said of it
BROKEN = {
    "no index": (lambda f: (f / "model_index.json").unlink(), "model/model_index.json: No such"),
    "no JSON": (written("model_index.json", "{"), "model/model_index.json is not JSON"),
    "a list": (written("model_index.json", "[]"), "model/model_index.json is no table"),
    "of pictures": (
        index(transformer=["diffusers", "FluxTransformer2DModel"]), "is of no kind that is known",
    ),
    "another coder": (
        index(vae=["diffusers", "AutoencoderDC"]), "its vae is a AutoencoderDC, where Autoencoder",
    ),
    "no reader": (index(text_encoder=[None, None]), "model_index.json has no text_encoder"),
    "of two models": (
        index(transformer_2=["diffusers", "WanTransformer3DModel"]), "is a Wan 2.2 of two models",
    ),
    "by a picture": (written("transformer/config.json", '{"image_dim": 9}'), "goes by a picture"),
    "no settings": (lambda f: (f / "vae" / "config.json").unlink(), "vae/config.json: No such"),
    "no tokenizer": (lambda f: (f / "tokenizer").rmdir(), "the folder tokenizer is missing"),
    "no weights": (
        lambda f: (f / "vae" / "model.safetensors").unlink(), "vae has no .safetensors"
    ),
    "cut off": (
        lambda f: (f / "vae" / "model.safetensors").write_bytes(weights(20)),
        "vae/model.safetensors is cut off",
    ),
    "of something else": (
        lambda f: (f / "vae" / "model.safetensors").write_bytes(b"PK" * 40),
        "vae/model.safetensors holds no weights that can be read",
    ),
    "one part of two": (shard, "transformer/model-2.safetensors is missing"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_a_model_that_is_not_whole_is_told(beside, capsys, name):
    broken, said = BROKEN[name]
    broken(beside / "model")
    file, told = refused(capsys, beside, TEXT)
    assert told.startswith(f"{file}:7: sds.model: "), told
    assert said in told and told.endswith("got 'model'"), told
    assert not (beside / "fit").exists()


def test_weights_in_half_precision_alone_are_taken(beside):
    part = beside / "model" / "vae"
    (part / "model.safetensors").rename(part / "model.fp16.safetensors")
    found = Folder(beside / "model").part("vae", ("AutoencoderKLWan",))
    assert (found.variant, found.numbers) == ("fp16", 6)
    (part / "model.safetensors").write_bytes(weights())
    found = Folder(beside / "model").part("vae", ("AutoencoderKLWan",))
    assert (found.variant, found.numbers, len(found.files)) == (None, 6, 1)
    with pytest.raises(ModelError, match="no such folder"):
        Folder(beside / "modell")


@pytest.mark.parametrize(
    "picture, said",
    [
        ("gone.png", "no such file"),
        ("broken.png", "cannot identify image file"),
        ("wide.png", "is of another shape, 90 x 60 pixels, than the 64 x 64 of the rest"),
    ],
)
def test_a_first_picture_that_cannot_be_read_is_told(beside, capsys, monkeypatch, picture, said):
    monkeypatch.setattr("vgmpi.tools.fit.video_prior.models.flow_matching.Flow.by", "image")
    text = TEXT.replace(sds_fits.PROMPT, f'image = "{picture}"')
    file, told = refused(capsys, beside, text)
    assert told.startswith(f"{file}:9: sds.image: ") and said in told


def test_a_wrong_render_toml_is_told_by_its_own_line(beside, capsys):
    (beside / "render.toml").write_text("[picture]\nwidht = 3\n")
    _, told = refused(capsys, beside, TEXT)
    assert f"{beside / 'render.toml'}:2: picture.widht" in told


def test_missing_packages_are_named(beside, capsys, monkeypatch):
    """With what installs them."""
    monkeypatch.setattr(denoising_target, "PACKAGES", ("numpy", "diffuserz"))
    scene, file = write_fit(beside, BALL, TEXT)
    assert fit.main([str(scene), str(file), "-o", str(beside / "fit")]) == 1
    told = capsys.readouterr().err.strip()
    assert told == "vgmpi: [sds] needs diffuserz: pip install 'vgmpi[sds]'"


def test_what_does_not_fit_into_the_memory_is_refused(beside, capsys, monkeypatch):
    monkeypatch.setattr(denoising_target, "PACKAGES", ())
    monkeypatch.setattr(denoising_target, "_has_gpu", lambda: False)
    monkeypatch.setattr("vgmpi.runtime.process_limits.available_memory", lambda swap=False: 1 << 10)
    file, told = refused(capsys, beside, TEXT)
    assert told.startswith(f"{file}:7: sds.model: WanTransformer3DModel in float32 takes about ")
    assert "are free on this machine" in told
