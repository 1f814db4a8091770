"""Score distillation through differences: on random models of each kind, loaded as real ones are,
against autograd; what they are asked against diffusers' own pipelines and schedulers."""

import importlib.util
import shutil

import numpy as np
import pytest

from tests.support import launch, sds_fits, tiny_video_models
from tests.support.fit_scenes import BALL, bits, command, go, write_fit
from vgmpi.scene.loader import load
from vgmpi.tools.fit import __main__ as fit
from vgmpi.tools.fit import sds_descent
from vgmpi.tools.fit.evaluations import Evaluations
from vgmpi.tools.fit.fit_config import FitFile, FitFileError
from vgmpi.tools.fit.video_prior import score_distillation
from vgmpi.tools.fit.video_prior.denoising_target import PACKAGES, DenoisingTarget

GONE = [name for name in PACKAGES if importlib.util.find_spec(name) is None]
if GONE:
    pytest.skip(f"no {', '.join(GONE)}: pip install 'vgmpi[sds]'", allow_module_level=True)

import torch  # noqa: E402

KINDS = tuple(tiny_video_models.MAKERS)
FRAMES, SIZE = 5, 32
NEAR = 0.02


@pytest.fixture(scope="module", autouse=True)
def alone():
    """One thread, no network."""
    threads, patch = torch.get_num_threads(), pytest.MonkeyPatch()
    torch.set_num_threads(1)
    patch.setenv("HF_HUB_OFFLINE", "1")
    yield
    patch.undo()
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """A folder with a model of each kind, a scene, and a first picture."""
    folder = tmp_path_factory.mktemp("models")
    for name in KINDS:
        tiny_video_models.saved(name, folder / name)
    sds_fits.rendered(folder, SIZE)
    first = sds_fits.blob(torch.tensor([4e4, 1000.0]), FRAMES, SIZE)[0].numpy()
    from PIL import Image

    Image.fromarray((first * 255).astype(np.uint8)).save(folder / "first.png")
    return folder


def wish(name):
    return 'image = "first.png"' if name == "edm" else sds_fits.PROMPT


def taste(
    models,
    name,
    more="noise_samples = 3",
    parameters=sds_fits.PARAMETERS + sds_fits.SECOND,
    method="",
):
    """A model's taste of runs that are pictures of a formula, and these runs."""
    text = sds_fits.sds(name, wish(name), f"frames = {FRAMES}\n{more}", method, parameters)
    scene, path = write_fit(models, BALL, text)
    file = FitFile(path, load(scene))
    target = DenoisingTarget(file)
    target.renderer = sds_fits.Shown(FRAMES, SIZE)
    shutil.rmtree(models / "runs", ignore_errors=True)
    return target, Evaluations(sds_fits.Formula(models / "runs"), file.axes, target, 40)


@pytest.fixture(params=KINDS)
def loaded(request, models):
    """A kind's name, its taste with its weights loaded, a film and its code."""
    target, _ = taste(models, request.param)
    with target._loaded_model():
        film = target.to_model_video(
            sds_fits.blob(torch.tensor([4e4, 1000.0]), FRAMES, SIZE).numpy()
        )
        with torch.no_grad():
            return request.param, target, film, target.kind.encode(film)


@pytest.mark.parametrize("name", KINDS)
def test_the_gradient_is_autograds(models, name):
    """By differences of whole codes, and by back-propagation through the coder and the picture."""
    target, trials = taste(models, name)
    at = np.array([0.55, 0.4])
    found = sds_descent.gradient(trials, at, 0.02)
    assert len(trials.all) == 2 * len(at) + 1
    u = torch.tensor(at, requires_grad=True)
    values = [a.low * torch.exp(x * a.width) for a, x in zip(trials.axes, u)]
    film = (
        sds_fits.blob(torch.stack(values), FRAMES, SIZE).float().permute(3, 0, 1, 2)[None] * 2 - 1
    )
    z = target.kind.encode(film)
    pulled = []
    for k, share in enumerate(score_distillation.stratified_levels((0.2, 0.8), 3)):
        one = score_distillation.draw(target.kind.level(share), tuple(z.shape), 1, k)
        with torch.no_grad():
            pulled.append(
                score_distillation.sds_gradient(
                    target.kind, z.detach(), one, target.kind.default_guidance
                )[0]
            )
    (torch.stack(pulled).mean(0) * z).mean().backward()
    assert np.abs(u.grad.numpy()).min() > 0
    assert found == pytest.approx(u.grad.numpy(), rel=NEAR)


def pipeline(models, name):
    import diffusers

    return diffusers.DiffusionPipeline.from_pretrained(models / name, local_files_only=True)


def own_conditions(pipe, name, target):
    """Those of the pipeline: without and with the prompt."""
    if name == "edm":
        from PIL import Image

        with Image.open(target.file.folder / "first.png") as image:
            embedded = pipe._encode_image(image.convert("RGB"), "cpu", 1, True)
        return embedded[:1], embedded[1:]
    count = {"num_videos_per_prompt" if name == "flow" else "num_images_per_prompt": 1}
    with torch.no_grad():
        if name == "flow":
            count["max_sequence_length"] = 512
        there, without = pipe.encode_prompt(
            "a soft ball bounces", device="cpu", do_classifier_free_guidance=True, **count
        )
    return without, there


def test_conditions_are_the_pipelines(loaded, models):
    name, target, _, _ = loaded
    own, found = own_conditions(pipeline(models, name), name, target), target.kind.conditions
    if name == "edm":
        assert not found[0][0].any() and not found[0][1].any() and found[1][1].any()
        found = (found[0][0], found[1][0])  # the picture is made larger in a way of its own
    for one, other in zip(found, own):
        off = (one - other).abs().max()
        assert off <= (0.05 * other.abs().max() if name == "edm" else 1e-5)
    assert (found[0] - found[1]).abs().max() > 0.01


def check_guided(target, z):
    """What guidance does shows."""
    one = score_distillation.draw(target.kind.level(0.5), tuple(z.shape), 1, 0)
    with torch.no_grad():
        plain, loss = score_distillation.sds_gradient(target.kind, z, one, 1.0)
        guided, same = score_distillation.sds_gradient(
            target.kind, z, one, target.kind.default_guidance
        )
        without, _ = score_distillation.sds_gradient(target.kind, z, one, 0.0)
    assert loss == same == score_distillation.denoising_loss(target.kind, z, one)
    change = guided - plain
    assert change.abs().mean() > 1e-3 * plain.abs().mean(), "guidance does nothing"
    assert torch.allclose(
        change, (target.kind.default_guidance - 1) * (plain - without), rtol=1e-3, atol=1e-4
    )


def test_guidance_has_two_halves(loaded):
    _, target, _, z = loaded
    check_guided(target, z)


def test_halves_that_are_the_same_are_seen(loaded):
    """The same embeddings in both halves, as others feed them, make guidance nothing."""
    _, target, _, z = loaded
    target.kind.conditions = (target.kind.conditions[1],) * 2
    with pytest.raises(AssertionError, match="guidance does nothing"):
        check_guided(target, z)


def by_scheduler(name, pipe, target, z, eps):
    """Level's share, z_t and the clean code that diffusers' own scheduler makes of the model's
    answer to the prompt."""
    levels, condition = pipe.scheduler, target.kind.conditions[1]
    if name in ("epsilon", "velocity"):
        levels.set_timesteps(1000)
        t = torch.tensor(430)
        z_t = levels.add_noise(z, eps, t[None])
        told = pipe.unet(z_t, t, encoder_hidden_states=condition).sample
        return 0.4305, z_t, levels.step(told, t, z_t).pred_original_sample
    if name == "edm":
        levels.set_timesteps(25)
        t, sigma = levels.timesteps[14], float(levels.sigmas[14])
        z_t = z + sigma * eps
        films = z_t.transpose(1, 2)
        first = condition[1][:, None].repeat(1, FRAMES, 1, 1, 1)
        shown = torch.cat([levels.scale_model_input(films, t), first], 2)
        ids = pipe._get_add_time_ids(6, 127, 0.02, torch.float32, 1, 1, False)
        told = pipe.unet(shown, t, encoder_hidden_states=condition[0], added_time_ids=ids).sample
        clean = levels.step(told, t, films).pred_original_sample
        return sigma / (1 + sigma), z_t, clean.transpose(1, 2)
    levels.set_timesteps(sigmas=[0.4])  # the scheduler moves it, and goes from there to 0
    t = levels.timesteps[0]
    z_t = levels.scale_noise(z, t[None], eps)
    told = pipe.transformer(z_t, t[None], encoder_hidden_states=condition).sample
    return float(t) / 1000, z_t, levels.step(told, t, z_t).prev_sample


def test_the_guess_is_the_schedulers(loaded, models):
    """What the noise is by ours and the clean code by theirs make up the noised one; so do our
    levels."""
    name, target, _, z = loaded
    eps = torch.randn(z.shape, generator=torch.Generator().manual_seed(5))
    with torch.no_grad():
        share, z_t, clean = by_scheduler(name, pipeline(models, name), target, z, eps)
        level = target.kind.level(share)
        assert torch.allclose(
            score_distillation.noised(z, score_distillation.NoiseSample(level, eps)), z_t, atol=1e-4
        )
        guess = target.kind.predict(z_t, level, target.kind.conditions[1])
    made_up = level.signal * clean + level.noise * guess
    assert torch.allclose(made_up, z_t, atol=2e-5 * float(z_t.abs().max()))
    assert (guess - eps).abs().mean() > 1e-3  # a random model guesses something


def test_codes_are_what_the_pipelines_decode(loaded, models):
    """A code taken back as the pipeline does before it decodes is the coder's own."""
    name, target, film, z = loaded
    vae = pipeline(models, name).vae
    with torch.no_grad():
        if name == "flow":
            own = vae.encode(film).latent_dist.mode()
            shape = (1, vae.config.z_dim, 1, 1, 1)
            spread = 1.0 / torch.tensor(vae.config.latents_std).view(shape)
            back = z / spread + torch.tensor(vae.config.latents_mean).view(shape)
        else:
            own = torch.cat([vae.encode(film[:, :, k]).latent_dist.mode() for k in range(FRAMES)])
            back = (z / vae.config.scaling_factor)[0].transpose(0, 1)
    assert torch.allclose(own, back, atol=1e-5)


def test_draws_are_the_same_for_all_runs(models):
    target, _ = taste(models, "epsilon")
    with target._loaded_model():
        first, again = (list(target._draws((1, 4, 5, 16, 16))) for _ in range(2))
    assert all(torch.equal(a.eps, b.eps) and a.level == b.level for a, b in zip(first, again))
    assert len({one.level.time for one in first}) == len(first) == 3
    assert not torch.equal(first[0].eps, first[1].eps)
    other = score_distillation.draw(first[0].level, tuple(first[0].eps.shape), 2, 0)
    assert not torch.equal(first[0].eps, other.eps)
    assert abs(float(first[0].eps.mean())) < 0.1 and float(first[0].eps.std()) == pytest.approx(
        1, abs=0.1
    )


def test_what_was_said_of_a_run_is_not_asked_again(models):
    """A fit that goes on loads no model for what it knows; another seed is asked anew."""
    target, trials = taste(models, "flow")
    first = sds_descent.gradient(trials, np.array([0.5, 0.5]), 0.02)
    fresh = DenoisingTarget(target.file)
    fresh.renderer, fresh.kind.load = target.renderer, None
    again = Evaluations(sds_fits.Formula(models / "runs"), trials.axes, fresh, 40)
    assert np.array_equal(sds_descent.gradient(again, np.array([0.5, 0.5]), 0.02), first)
    one, other = (min(t.number for t in of.all.values()) for of in (trials, again))
    assert one == other and not fresh.loaded
    assert [t.loss for t in again.all.values()][0] == [t.loss for t in trials.all.values()][0]
    write_fit(
        models,
        BALL,
        target.file.source.text.replace("noise_samples = 3", "noise_samples = 3\nseed = 9"),
    )
    seeded = DenoisingTarget(FitFile(models / "fit.toml", target.file.scene))
    folder = next(iter(trials.all.values())).done.folder
    assert (
        seeded._load_cached(folder, "loss") is None
        and target._load_cached(folder, "loss") is not None
    )
    (folder / "fit.json").write_text("{}")  # made anew
    assert target._load_cached(folder, "loss") is None
    (folder / "fit.json").unlink()
    (folder / "sds_loss.npz").write_bytes(b"PK half of it")
    assert target._load_cached(folder, "loss") is None


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_weights_may_be_half_as_large(models, name, precision):
    target, trials = taste(models, name, f'noise_samples = 1\nprecision = "{precision}"')
    (run,) = trials.evaluate([np.array([0.5, 0.5])])
    assert np.isfinite(run.loss) and run.loss > 0
    assert getattr(torch, precision) in {p.dtype for p in target.kind.model.parameters()}
    assert target.code(run.done.folder).dtype == np.float32


def test_memory_is_named_before_it_loads(models, monkeypatch):
    target, _ = taste(models, "edm")
    assert target.preamble.startswith("UNetSpatioTemporalConditionModel in float32 takes about ")
    assert target.preamble.endswith("of memory on cpu, for 5 frames of 32 x 32 pixels")
    assert not target.loaded
    weights = sum(p.numel() for p in pipeline(models, "edm").unet.parameters())
    assert target.kind.denoises.numbers == weights
    monkeypatch.setattr("vgmpi.runtime.process_limits.available_memory", lambda swap=False: 1 << 20)
    with pytest.raises(FitFileError, match=r"sds.model: UNetSpatio.* 1 MiB|0.000977 GiB are free"):
        taste(models, "edm")


def test_weights_that_do_not_fit_are_told(models):
    """One line, where diffusers cannot make a model of what is there."""
    broken = models / "broken"
    shutil.rmtree(broken, ignore_errors=True)
    shutil.copytree(models / "flow", broken)
    config = broken / "transformer" / "config.json"
    config.write_text(
        config.read_text().replace('"num_layers": 2', '"num_layers": 2, "ffn_dim": 8')
    )
    config.write_text(config.read_text().replace('"ffn_dim": 16', '"eps": 1e-6'))
    target, trials = taste(models, "flow")
    write_fit(models, BALL, target.file.source.text.replace('"flow"', '"broken"'))
    other = DenoisingTarget(FitFile(models / "fit.toml", target.file.scene))
    other.renderer = target.renderer
    with pytest.raises(FitFileError) as told:
        Evaluations(trials.runs, trials.axes, other, 40).evaluate([np.array([0.5, 0.5])])
    assert len(told.value.lines) == 1 and "sds.model: cannot be asked: " in told.value.lines[0]


def test_a_step_goes_to_where_two_gradients_meet_zero():
    """Of two parameters that depend on each other, within a few steps."""
    H, there = np.array([[1.0, 0.4], [0.4, 0.7]]), np.array([0.3, 0.8])
    places, slopes = [np.array([0.9, 0.2])], []
    slopes.append(H @ (places[0] - there))
    step = -0.1 * np.sign(slopes[0])
    for _ in range(12):
        places.append(np.clip(places[-1] + step, 0, 1))
        slopes.append(H @ (places[-1] - there))
        step = sds_descent.quickprop_step(places, slopes)
    assert places[-1] == pytest.approx(there, abs=5e-3)


SHORT = "max_runs = 12\nscan_points = 2"


@pytest.fixture(scope="module")
def whole(models):
    """The folder of a fit by the command, with a random model, that nobody stopped."""
    scene, file = command_files(models)
    assert fit.main([str(scene), str(file), "-o", str(models / "whole")]) == 0
    return models / "whole"


def command_files(models):
    folder = models / "command"
    folder.mkdir(exist_ok=True)
    sds_fits.rendered(folder, SIZE)
    return write_fit(
        folder, BALL, sds_fits.sds("../flow", more="frames = 5\nnoise_samples = 2", method=SHORT)
    )


def test_the_command_says_what_it_takes_and_writes_what_it_found(models, whole, capsys):
    """The same again makes no run, and asks the model nothing."""
    before = bits(whole)
    stamps = {p: p.stat().st_mtime_ns for p in whole.glob("runs/*/*.npz")}
    scene, file = command_files(models)
    capsys.readouterr()
    assert fit.main([str(scene), str(file), "-o", str(whole)]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("WanTransformer3DModel in float32 takes about ")
    assert bits(whole) == before and len(before[0]) <= 12 and stamps
    assert all(p.stat().st_mtime_ns == stamp for p, stamp in stamps.items())
    found = load(whole / "fitted.toml").material["rubber"].youngs_modulus
    assert 4e3 <= found <= 4e5 and "not known" in (whole / "report.md").read_text()
    blank = [row for row in before[0] if not row["loss"]]
    assert {row["purpose"] for row in blank} == {"descent"}


def test_a_killed_fit_goes_on_with_the_same_bits(models, whole, monkeypatch):
    """By SIGKILL, after a run that the model was asked about."""
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    scene, file = command_files(models)
    out = models / "killed"
    begun = launch.start(command(scene, file, out))
    launch.until(lambda: len(list(out.glob("runs/*/sds_pull.npz"))) >= 2, "a run's gradient")
    assert begun.poll() is None  # it was not done before
    begun.kill()
    begun.communicate()
    kept = {p: p.stat().st_mtime_ns for p in out.glob("runs/*/sds_*.npz")}
    done = go(scene, file, out)
    assert done.returncode == 0, done.stderr
    assert bits(out) == bits(whole)
    assert len(kept) >= 4 and all(p.stat().st_mtime_ns == stamp for p, stamp in kept.items())
