"""Reading and writing .splat files, byte for byte."""

import numpy as np
import pytest

from tests.gaussians.test_ply import cloud
from tests.support import gaussian_files
from vgmpi.gaussians.formats import splat
from vgmpi.gaussians.spherical_harmonics import C0


def save(folder, rows):
    path = folder / "cloud.splat"
    path.write_bytes(gaussian_files.splat(rows))
    return path


def test_the_layout(tmp_path):
    rows = [
        ((1, 2, 3), (0.1, 0.2, 0.3), (255, 0, 51, 102), (255, 128, 128, 128)),
        ((4, 5, 6), (1, 1, 0), (0, 0, 0, 255), (128, 128, 0, 128)),
    ]
    c = splat.read_splat(save(tmp_path, rows))
    np.testing.assert_array_equal(c.x, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_allclose(c.scale, [[0.1, 0.2, 0.3], [1, 1, 0]], rtol=1e-6)
    np.testing.assert_allclose(c.opacity, [0.4, 1])
    np.testing.assert_allclose(c.sh[0, 0] * C0 + 0.5, [1, 0, 0.2], atol=1e-6)
    np.testing.assert_allclose(c.quat, [[1, 0, 0, 0], [0, 0, -1, 0]])
    assert c.sh.shape == (2, 1, 3)


@pytest.mark.parametrize("k", [1, 16])
def test_written_clouds_come_back_to_half_a_step(tmp_path, k):
    c = cloud(300, k=k)
    splat.write_splat(tmp_path / "c.splat", c)
    assert (tmp_path / "c.splat").stat().st_size == 32 * 300
    d = splat.read_splat(tmp_path / "c.splat")
    np.testing.assert_allclose(d.x, c.x, rtol=1e-6)
    np.testing.assert_allclose(d.scale, c.scale, rtol=1e-6)
    assert np.abs(d.opacity - c.opacity).max() <= 0.5 / 255 + 1e-12
    assert np.abs(d.rgb - c.rgb).max() <= 0.5 / 255 + 1e-6
    assert np.abs((d.quat * c.quat).sum(axis=1)).min() > 1 - 1e-4
    assert [p.name for p in tmp_path.iterdir()] == ["c.splat"]


def test_what_is_written(tmp_path):
    """The bytes themselves: -1 is 0, and 1, which would be 256, is 255."""
    c = cloud(1, k=1)
    c.quat[:] = [1, 0, -1, 0]
    c.opacity[:], c.sh[:] = 1, 0
    splat.write_splat(tmp_path / "c.splat", c)
    data = (tmp_path / "c.splat").read_bytes()
    numbers = np.array([*c.x[0], *c.scale[0]], dtype="<f4")
    np.testing.assert_array_equal(np.frombuffer(data[:24], "<f4"), numbers)
    assert data[24:] == bytes([128, 128, 128, 255, 255, 128, 0, 128])


def test_more_rows_than_one_block(tmp_path):
    """Rows keep their order across blocks, and a stray broken one is dropped from its own."""
    n = 40_000
    data = np.frombuffer(
        gaussian_files.splat([((0, 0, 0), (1, 1, 1), (0,) * 4, (255,) * 4)] * n), "u1"
    )
    words = data.reshape(n, 32).copy()
    words[:, :4] = np.arange(n, dtype="<f4")[:, None].view("u1")
    words[20_000, 28:] = 128  # no rotation
    (tmp_path / "c.splat").write_bytes(words.tobytes())
    c = splat.read_splat(tmp_path / "c.splat")
    np.testing.assert_array_equal(c.x[:, 0], np.delete(np.arange(n), 20_000))
    assert c.record.omissions[0].startswith("1 of 40,000 Gaussians are not finite")
