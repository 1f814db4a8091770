"""What the gsplat backend hands over, by stand-ins for torch and gsplat: no graphics card here.

The stand-in of gsplat checks its arguments' shapes and draws with the dense renderer, so that what
comes back is compared with the processor's picture.
"""

import sys
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.postprocess.test_splat import camera, scene
from tests.support import dense_rasterizer
from vgmpi.gaussians.camera import Camera
from vgmpi.gaussians.cloud import unpack_symmetric
from vgmpi.postprocess.raster import rasterize
from vgmpi.postprocess.raster.gsplat_backend import BackendError


class Tensor:
    """As much of a torch.Tensor as is used."""

    def __init__(self, array):
        self.array = array

    def __getitem__(self, item):
        return Tensor(self.array[item])

    def cpu(self):
        return self

    def numpy(self):
        return self.array


def rasterization(
    *, means, covars, opacities, colors, viewmats, Ks, width, height, near_plane, **more
):  # fmt: skip
    """gsplat 1.5's, for one camera: float32 tensors on the card, colors without background."""
    given = (means, covars, opacities, colors, viewmats, Ks)
    means, covars, opacities, colors, viewmats, Ks = (t.array for t in given)
    assert all(t.array.dtype == np.float32 for t in given)
    n = len(means)
    assert [more.pop(name) for name in ("quats", "scales", "backgrounds")] == [None] * 3
    eps2d, rasterize_mode, render_mode = map(more.pop, ("eps2d", "rasterize_mode", "render_mode"))
    assert not more
    assert covars.shape == (n, 3, 3) and opacities.shape == (n,) and colors.shape == (n, 3)
    assert viewmats.shape == (1, 4, 4) and Ks.shape == (1, 3, 3)
    assert rasterize_mode in ("classic", "antialiased") and render_mode in ("RGB", "RGB+ED")
    k = Ks[0].astype(float)
    lens = k[0, 0], k[1, 1], k[0, 2], k[1, 2]
    seen = Camera(viewmats[0].astype(float), *lens, width, height, near_plane)
    shape = means.astype(float), covars.astype(float), opacities.astype(float)
    options = {"lowpass": eps2d, "antialias": rasterize_mode == "antialiased"}
    image, left = dense_rasterizer.render(*shape, colors.astype(float), seen, (0, 0, 0), **options)
    if render_mode == "RGB+ED":
        depth = dense_rasterizer.depths(*shape, seen, **options)["expected"]
        image = np.concatenate([image, np.where(left < 1, depth, 0)[..., None]], axis=-1)
    return Tensor(np.float32(image)[None]), Tensor(np.float32(1 - left)[None, ..., None]), {}


@pytest.fixture
def card(monkeypatch):
    def as_tensor(array, device):
        assert device == "cuda"
        return Tensor(array)

    torch = SimpleNamespace(
        as_tensor=as_tensor,
        no_grad=nullcontext,
        cuda=SimpleNamespace(is_available=lambda: True),
    )
    monkeypatch.setitem(sys.modules, "torch", torch)
    monkeypatch.setitem(sys.modules, "gsplat", SimpleNamespace(rasterization=rasterization))
    return torch


@pytest.mark.parametrize("antialias", [False, True])
@pytest.mark.parametrize("lowpass", [0.3, 0.1])
def test_draws_what_the_processor_draws(card, lowpass, antialias):
    splats, seen = scene(150, 3), camera()
    ground = np.random.default_rng(0).random((seen.height, seen.width, 3))
    options = {"lowpass": lowpass, "antialias": antialias, "depth": "expected"}
    want = rasterize.render(splats, seen, ground, **options)
    got = rasterize.render(splats, seen, ground, backend="gsplat", **options)
    for a, b in zip(got, want):
        assert a.shape == b.shape and a.dtype == b.dtype == np.float32
        assert (np.isfinite(a) == np.isfinite(b)).mean() > 0.999
        both = np.isfinite(a) & np.isfinite(b)
        assert np.quantile(np.abs(a[both] - b[both]), 0.999) < 1e-4
    assert len(rasterize.render(splats, seen, backend="gsplat")) == 2
    twice = rasterize.render(splats, seen, backend="gsplat", supersample=2)[0]
    assert np.abs(twice - rasterize.render(splats, seen, supersample=2)[0]).mean() < 1e-5


def mixed(splats, *values):
    """The Gaussians with lowpasses of their own."""
    own = np.random.default_rng(0).choice(values, len(splats.x))
    return replace(splats, compensated_lowpass=own)


@pytest.mark.parametrize("values", [(0.0, 0.3), (0.1, 0.1), (0.0, 0.0)])
def test_draws_gaussians_by_their_render_models(card, values):
    splats, seen = mixed(scene(150, 3), *values), camera()
    got = rasterize.render(splats, seen, backend="gsplat")
    for a, b in zip(got, rasterize.render(splats, seen)):
        assert np.quantile(np.abs(a - b), 0.999) < 1e-4
    other = replace(splats, compensated_lowpass=None)
    told_apart = np.abs(got[0] - rasterize.render(other, seen)[0]).max() > 0.01
    assert told_apart == any(values)


def test_several_lowpasses_in_one_picture_are_refused(card):
    splats = mixed(scene(150, 3), 0.0, 0.1)
    with pytest.raises(BackendError, match="one lowpass"):
        rasterize.render(splats, camera(), backend="gsplat")
    rasterize.render(splats, camera(), backend="gsplat", lowpass=0.1)


def test_covariances_are_whole_and_symmetric(card):
    """A wrong order of the six numbers would pass for balls."""
    splats = scene(3, 1)
    tall = unpack_symmetric(splats.cov)
    seen = {}
    sys.modules["gsplat"].rasterization = lambda **a: seen.update(a) or rasterization(**a)
    rasterize.render(splats, camera(), backend="gsplat")
    np.testing.assert_allclose(seen["covars"].array, tall, rtol=1e-6)


def test_what_gsplat_cannot_do_is_said(card):
    with pytest.raises(BackendError, match="median"):
        rasterize.render(scene(3), camera(), backend="gsplat", depth="median")
    with pytest.raises(BackendError, match="alpha_min"):
        rasterize.render(scene(3), camera(), backend="gsplat", alpha_min=1e-4)


@pytest.mark.parametrize("absent", ["torch", "gsplat"])
def test_what_is_missing_is_named(card, monkeypatch, absent):
    monkeypatch.setitem(sys.modules, absent, None)
    with pytest.raises(BackendError, match=f"{absent}.*gpu-render"):
        rasterize.render(scene(3), camera(), backend="gsplat")


def test_a_machine_without_a_card_is_named(card):
    card.cuda.is_available = lambda: False
    with pytest.raises(BackendError, match="CUDA"):
        rasterize.render(scene(3), camera(), backend="gsplat")


def test_torch_is_not_asked_for_by_others(monkeypatch):
    for name in ("torch", "gsplat"):
        monkeypatch.setitem(sys.modules, name, None)
    rasterize.render(scene(3), camera())
