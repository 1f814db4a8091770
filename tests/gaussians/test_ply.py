"""Reading and writing Gaussian files."""

import sys
from pathlib import Path

import numpy as np
import pytest

from tests.support import gaussian_files
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.formats import ply
from vgmpi.gaussians.formats import registry as of_any_kind
from vgmpi.gaussians.spherical_harmonics import C0

GUITAR = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "guitar.compressed.ply"


def cloud(n=40, k=16, seed=0):
    rng = np.random.default_rng(seed)
    quat = rng.normal(size=(n, 4))
    return GaussianCloud(
        rng.normal(size=(n, 3)),
        quat / np.linalg.norm(quat, axis=1, keepdims=True),
        np.exp(rng.uniform(-8, 0, (n, 3))),
        rng.uniform(0.001, 0.999, n),
        rng.normal(size=(n, k, 3)),
    )


def save(folder, data):
    path = folder / "cloud.ply"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_the_plain_layout(tmp_path, order, end):
    rows = [gaussian_files.row(), gaussian_files.row(x=(4, 5, 6), opacity=-2.0, rot=(0, 0, 3, 4))]
    c = ply.read(save(tmp_path, gaussian_files.plain(rows, order=order, end=end)))
    np.testing.assert_allclose(c.x, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_allclose(c.opacity, 1 / (1 + np.exp([-0.5, 2.0])), rtol=1e-6)
    np.testing.assert_allclose(c.scale[0], np.exp([-3, -4, -5]), rtol=1e-6)
    np.testing.assert_allclose(c.quat[1], [0, 0, 0.6, 0.8], rtol=1e-6)
    np.testing.assert_allclose(c.sh[0, 0], [0.1, 0.2, 0.3], rtol=1e-6)
    assert c.sh.shape == (2, 1, 3)


@pytest.mark.parametrize("k", [4, 9, 16])
def test_the_rest_of_the_colors_is_stored_channel_after_channel(tmp_path, k):
    rest = np.arange(3 * (k - 1))
    c = ply.read(
        save(tmp_path, gaussian_files.plain([gaussian_files.row(rest=rest)], rest=len(rest)))
    )
    assert c.sh.shape == (1, k, 3)
    for channel in range(3):
        np.testing.assert_array_equal(c.sh[0, 1:, channel], np.arange(k - 1) + channel * (k - 1))


@pytest.mark.parametrize("k", [1, 4, 9, 16])
def test_written_clouds_come_back(tmp_path, k):
    c = cloud(k=k)
    ply.write(tmp_path / "c.ply", c)
    d = ply.read(tmp_path / "c.ply")
    for name in ("x", "scale", "opacity", "sh", "quat"):
        np.testing.assert_allclose(getattr(d, name), getattr(c, name), rtol=1e-5, atol=1e-6)
    assert [p.name for p in tmp_path.iterdir()] == ["c.ply"]


def test_full_and_no_opacity_and_flat_discs_can_be_written(tmp_path):
    c = cloud(3)
    c.opacity[:] = [0, 1, 0.5]
    c.scale[0, 2] = 0
    ply.write(tmp_path / "c.ply", c)
    d = ply.read(tmp_path / "c.ply")
    np.testing.assert_allclose(d.opacity, [0, 1, 0.5], atol=1e-6)
    np.testing.assert_allclose(d.scale, c.scale, rtol=1e-5, atol=1e-20)


@pytest.mark.parametrize("color_bounds", [True, False])
@pytest.mark.parametrize("rest", [0, 9, 45])
def test_the_compressed_layout(tmp_path, color_bounds, rest):
    """300 Gaussians in two chunks of very different size, to within the steps of the packing."""
    rng = np.random.default_rng(1)
    n = 300
    x = rng.normal(size=(n, 3)) * np.where(np.arange(n) < 256, 1, 100)[:, None]
    quat, log_scale = rng.normal(size=(n, 4)), rng.uniform(-9, 0, (n, 3))
    rgb, opacity = rng.random((n, 3)), rng.random(n)
    bytes_ = rng.integers(0, 256, (n, rest)) if rest else None
    data = gaussian_files.compressed(x, quat, log_scale, rgb, opacity, bytes_, color_bounds)
    c = ply.read(save(tmp_path, data))
    reach = np.where(np.arange(n) < 256, np.ptp(x[:256]), np.ptp(x[256:]))[:, None]
    assert (np.abs(c.x - x) <= 0.5 * reach / 1023 + 1e-4).all()
    assert np.abs(np.log(c.scale) - log_scale).max() <= 9 / 1023
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    assert np.abs(np.sum(c.quat * quat, axis=1)).min() > 1 - 1e-5
    np.testing.assert_allclose(np.linalg.norm(c.quat, axis=1), 1, atol=1e-12)
    assert np.abs(c.opacity - opacity).max() <= 0.51 / 255
    assert np.abs(c.sh[:, 0] * C0 + 0.5 - rgb).max() <= 0.51 / 255
    assert c.sh.shape[1] == rest // 3 + 1
    if rest:
        want = (bytes_.reshape(n, 3, -1).transpose(0, 2, 1) / 255 - 0.5) * 8
        assert np.abs(c.sh[:, 1:] - want).max() <= 8 / 255
        ends = np.isin(bytes_, (0, 255)).reshape(n, 3, -1).transpose(0, 2, 1)
        np.testing.assert_array_equal(np.abs(c.sh[:, 1:][ends]), 4)


@pytest.mark.parametrize("k", [1, 4, 16])
def test_the_compressed_layout_is_written(tmp_path, k):
    """To within the steps of the packing, between bounds of 256 Gaussians each."""
    pytest.importorskip("gsply")
    c = cloud(300, k)
    c.opacity[:3], c.scale[0, 2] = [0, 1, 0.5], 0
    c.x[256:] *= 100
    of_any_kind.write(tmp_path / "c.compressed.ply", c)
    assert [p.name for p in tmp_path.iterdir()] == ["c.compressed.ply"]
    d = of_any_kind.read(tmp_path / "c.compressed.ply")
    assert len(d) == 300 and d.sh.shape[1] == k
    for some in (slice(0, 256), slice(256, None)):
        reach = np.ptp(c.x[some], axis=0)
        assert (np.abs(d.x[some] - c.x[some]) <= 0.51 * reach / 1023).all()
    assert np.abs(np.log(d.scale[1:] / c.scale[1:])).max() <= 20 / 1023
    assert d.scale[0, 2] < 1e-8
    assert np.abs((d.quat * c.quat).sum(axis=1)).min() > 1 - 1e-5
    assert np.abs(d.opacity - c.opacity).max() <= 0.51 / 255
    assert np.abs(d.sh[:, 0] - c.sh[:, 0]).max() <= 0.51 * np.ptp(c.sh[:, 0]) / 255
    if k > 1:
        assert np.abs(d.sh[:, 1:] - np.clip(c.sh[:, 1:], -4, 4)).max() <= 0.51 / 32


def test_a_compressed_file_without_its_package(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "gsply", None)
    with pytest.raises(ply.GaussianFileError, match=r"needs the package gsply: pip install"):
        ply.write_compressed(tmp_path / "c.compressed.ply", cloud(3))
    assert not list(tmp_path.iterdir())


def test_a_few_stray_rows_are_dropped_and_told(tmp_path):
    rows = [gaussian_files.row() for _ in range(500)]
    rows[7] = gaussian_files.row(x=(np.nan, 0, 0))
    rows[8] = gaussian_files.row(rot=(0, 0, 0, 0))
    c = ply.read(save(tmp_path, gaussian_files.plain(rows)))
    assert len(c) == 498
    assert c.record.omissions[0].startswith("2 of 500 Gaussians are not finite")
    assert np.isfinite(c.x).all() and np.isfinite(c.quat).all()


def test_infinite_logits_are_full_and_no_opacity(tmp_path):
    rows = [
        gaussian_files.row(opacity=np.inf),
        gaussian_files.row(opacity=-np.inf),
        gaussian_files.row(scale=(-np.inf, 0, 0)),
    ]
    c = ply.read(save(tmp_path, gaussian_files.plain(rows)))
    np.testing.assert_array_equal(c.opacity[:2], [1, 0])
    assert c.scale[2, 0] == 0


@pytest.mark.data
def test_a_real_capture():
    if not GUITAR.exists():
        pytest.skip(f"{GUITAR} is not here")
    c = ply.read(GUITAR)
    assert len(c) == 90854
    assert c.sh.shape == (90854, 1, 3)
    assert (c.opacity >= 0).all() and (c.opacity <= 1).all()
    inside = np.quantile(c.x, [0.01, 0.99], axis=0)
    extent = inside[1] - inside[0]
    assert extent.argmax() == 1 and extent[1] > 3 * extent[0]  # it stands along its y axis
    warm = c.rgb[c.opacity > 0.5].mean(axis=0)
    assert warm[0] > warm[1] > warm[2]  # a brown guitar: channels in the right order
