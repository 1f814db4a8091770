"""The renderer against pictures made by gsplat's float64 reference, where they are at hand."""

from pathlib import Path

import numpy as np
import pytest

from tests.support import dense_rasterizer
from vgmpi.gaussians import spherical_harmonics
from vgmpi.gaussians.camera import Camera
from vgmpi.gaussians.cloud import GaussianCloud, unpack_symmetric
from vgmpi.postprocess.raster import rasterize

FOLDER = Path(__file__).resolve().parents[2].parent / "shared" / "oracle"
SCENES = ("fluid_2000_lowopacity", "sh3_300", "tiny_1500_subpixel")
MODES = {"classic_0.3": (0.3, False), "antialias_0.3": (0.3, True), "mip_0.1": (0.1, True)}

pytestmark = pytest.mark.data


def load(name):
    path = FOLDER / f"{name}.npz"
    if not path.exists():
        pytest.skip(f"{path} is not here")
    o = dict(np.load(path))
    cloud = GaussianCloud(o["in_xyz"], o["in_quat"], o["in_scale"], o["in_op"], o["in_sh"])
    lens = (float(o[f"in_{key}"]) for key in ("fx", "fy", "cx", "cy"))
    camera = Camera(o["in_W2C"], *lens, int(o["in_W"]), int(o["in_H"]))
    return o, cloud, camera


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("mode", MODES)
def test_agrees_with_the_oracle(name, mode):
    o, cloud, camera = load(name)
    color = spherical_harmonics.evaluate(o["in_sh"], cloud.x - camera.eye)
    lowpass, antialias = MODES[mode]
    image, left = rasterize.render(
        rasterize.ProjectableGaussians(cloud.x, cloud.cov(), cloud.opacity, color),
        camera,
        o["in_bg"],
        lowpass=lowpass,
        antialias=antialias,
    )
    error = np.abs(image - o[f"{mode}_image"])
    assert error.mean() < 1e-6
    assert error.max() < 5e-3
    assert np.abs(left - o[f"{mode}_T"]).max() < 5e-3


@pytest.mark.parametrize("name", SCENES)
def test_covariances_and_colors_are_the_oracles(name):
    o, cloud, camera = load(name)
    np.testing.assert_allclose(unpack_symmetric(cloud.cov()), o["cov3d"], atol=1e-15)
    np.testing.assert_allclose(
        spherical_harmonics.evaluate(o["in_sh"], cloud.x - camera.eye), o["color"], atol=1e-12
    )


@pytest.mark.parametrize("name", SCENES)
def test_the_dense_renderer_is_right_too(name):
    """So that what is compared with it alone is compared with the truth."""
    o, cloud, camera = load(name)
    color = dense_rasterizer.colors(o["in_sh"], cloud.x - camera.eye)
    np.testing.assert_allclose(color, o["color"], atol=1e-12)
    image, left = dense_rasterizer.render(
        cloud.x, unpack_symmetric(cloud.cov()), cloud.opacity, color, camera, o["in_bg"]
    )
    np.testing.assert_allclose(image, o["classic_0.3_image"], atol=1e-12)
    np.testing.assert_allclose(left, o["classic_0.3_T"], atol=1e-12)
