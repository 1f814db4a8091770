"""Reading and writing .spz files: byte for byte, and against another program."""

import gzip
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zstandard

from tests.gaussians.test_ply import cloud
from tests.support import gaussian_files
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.formats import spz
from vgmpi.gaussians.spherical_harmonics import C0

ROOT = Path(__file__).parents[2]
# x, alpha, rgb, scale, quat, the rest of the colors
ROW = ((4096, -8192, 1), (51,), (255, 0, 128), (160, 176, 144), (0, 0, 0, 192), ())
PACK = zstandard.ZstdCompressor(level=12).compress


def save(folder, data):
    path = folder / "cloud.spz"
    path.write_bytes(data)
    return path


def smallest_three(quat):
    """The word of a unit quaternion x, y, z, w, written as the format's page describes it."""
    largest = max(range(4), key=lambda i: abs(quat[i]))
    if quat[largest] < 0:
        quat = [-v for v in quat]
    word = largest
    for i in range(4):
        if i != largest:
            size = int(511 * abs(quat[i]) * 2**0.5 + 0.5)
            word = (word << 10) | (int(quat[i] < 0) << 9) | size
    return tuple(word.to_bytes(4, "little"))


def moderate(n=300, k=16, seed=0):
    """Gaussians that a .spz can hold."""
    c = cloud(n, k, seed)
    return GaussianCloud(c.x, c.quat, c.scale, c.opacity, np.clip(0.3 * c.sh, -0.99, 0.99))


def test_numbers_of_version_3(tmp_path):
    c = spz.read(save(tmp_path, gaussian_files.spz([ROW])))
    np.testing.assert_allclose(c.x, [[1, -2, 1 / 4096]])
    np.testing.assert_allclose(c.opacity, [0.2])
    np.testing.assert_allclose(np.log(c.scale), [[0, 1, -1]], atol=1e-12)
    np.testing.assert_allclose(c.sh[0, 0], (np.array([1, 0, 128 / 255]) - 0.5) / 0.15, rtol=1e-6)
    np.testing.assert_allclose(c.quat, [[1, 0, 0, 0]])


@pytest.mark.parametrize("bits", [0, 8, 24])
def test_fraction_bits(tmp_path, bits):
    c = spz.read(save(tmp_path, gaussian_files.spz([ROW], bits=bits)))
    np.testing.assert_array_equal(c.x, [[4096 / 2**bits, -8192 / 2**bits, 1 / 2**bits]])


def test_the_ends_of_24_bits(tmp_path):
    row = ((0x7FFFFF, -0x800000, 0), *ROW[1:])
    c = spz.read(save(tmp_path, gaussian_files.spz([row], bits=0)))
    np.testing.assert_array_equal(c.x, [[0x7FFFFF, -0x800000, 0]])


def test_version_1_has_half_floats_and_version_2_three_bytes_of_rotation(tmp_path):
    quat = (255, 128, 128)  # x, and almost no y and z
    row = ((1.5, -2.0, 0.25), *ROW[1:4], quat, ())
    c = spz.read(save(tmp_path, gaussian_files.spz([row], version=1)))
    np.testing.assert_array_equal(c.x, [[1.5, -2, 0.25]])
    np.testing.assert_allclose(c.quat, [[0, 1, 0, 0]], atol=0.005)
    c = spz.read(save(tmp_path, gaussian_files.spz([(ROW[0], *row[1:])], version=2)))
    np.testing.assert_allclose(c.x, [[1, -2, 1 / 4096]])
    np.testing.assert_allclose(c.quat, [[0, 1, 0, 0]], atol=0.005)


def test_rotations_of_every_kind(tmp_path):
    """Each component the largest, of either sign; from the description of the format."""
    quats = cloud(200).quat
    rows = [(*ROW[:4], smallest_three(list(np.roll(q, -1))), ()) for q in quats]
    assert len({int(np.abs(q).argmax()) for q in quats}) == 4
    c = spz.read(save(tmp_path, gaussian_files.spz(rows)))
    assert np.abs((c.quat * quats).sum(axis=1)).min() > 1 - 1e-5


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_the_rest_of_the_colors(tmp_path, degree):
    """Coefficient after coefficient, red, green and blue of each together."""
    k = ((degree + 1) ** 2 - 1) * 3
    rest = [(37 * i) % 256 for i in range(k)]
    c = spz.read(save(tmp_path, gaussian_files.spz([(*ROW[:5], rest)], degree=degree)))
    kept = min(k // 3, 15)
    assert c.sh.shape == (1, kept + 1, 3)
    want = (np.array(rest).reshape(-1, 3)[:kept] - 128) / 128
    np.testing.assert_array_equal(c.sh[0, 1:], want)
    left_out = ("colors of degree 4 are left out, the highest is 3",)
    assert c.record.omissions == (left_out if degree == 4 else ())


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("k", [1, 4, 9, 16])
def test_written_clouds_come_back_to_half_a_step(tmp_path, k, version):
    c = moderate(k=k)
    spz.write(tmp_path / "c.spz", c, version)
    d = spz.read(tmp_path / "c.spz")
    assert np.abs(d.x - c.x).max() <= 0.5 / 2**16
    assert np.abs(np.log(d.scale / c.scale)).max() <= 0.5 / 16 + 1e-12
    assert np.abs(d.opacity - c.opacity).max() <= 0.5 / 255 + 1e-12
    assert np.abs(d.sh[:, 0] - c.sh[:, 0]).max() * C0 <= 0.5 / 255 * C0 / 0.15 + 1e-6
    if k > 1:
        assert np.abs(d.sh[:, 1:] - c.sh[:, 1:]).max() <= 0.5 / 128 + 1e-6
    assert np.abs((d.quat * c.quat).sum(axis=1)).min() > 1 - 1e-5
    assert [p.name for p in tmp_path.iterdir()] == ["c.spz"]
    assert d.record.encoding == f".spz, version {version}"


def test_versions_that_are_not_written_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"version 2: allowed: \(3, 4\)"):
        spz.write(tmp_path / "c.spz", moderate(2), 2)


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("is_antialiased", [False, True])
def test_the_flag_of_antialiased_training(tmp_path, version, is_antialiased):
    """Bit 1 of the flags, byte 14 of the header."""
    c = replace(moderate(3), is_antialiased=is_antialiased)
    spz.write(tmp_path / "c.spz", c, version)
    data = (tmp_path / "c.spz").read_bytes()
    assert (gzip.decompress(data) if version == 3 else data)[14] & 1 == is_antialiased
    d = spz.read(tmp_path / "c.spz")
    assert d.is_antialiased == is_antialiased
    assert d.record.render_model_source == ("said by the file's flag" if is_antialiased else "")


def test_antialiased_training_of_files_by_hand(tmp_path):
    for flags in (0, 1):
        for data in (
            gaussian_files.spz([(*ROW[:4], (128, 128, 128), ())], version=2, flags=flags),
            gaussian_files.spz4([ROW], PACK, flags=flags),
        ):
            assert spz.read(save(tmp_path, data)).is_antialiased == bool(flags)


def test_far_positions_take_fewer_fraction_bits_and_too_far_ones_are_refused(tmp_path):
    c = moderate(2)
    c.x[0] = [1e6, 0, 0]
    spz.write(tmp_path / "c.spz", c)
    assert np.abs(spz.read(tmp_path / "c.spz").x - c.x).max() <= 0.5 / 2**3
    c.x[0] = [1e7, 0, 0]
    with pytest.raises(spz.GaussianFileError, match="cannot hold a position of 1e"):
        spz.write(tmp_path / "d.spz", c)
    assert not (tmp_path / "d.spz").exists()


@pytest.mark.parametrize("version", [3, 4])
def test_another_program_reads_and_writes_the_same(tmp_path, version):
    """gsply takes the numbers as they are, too."""
    other = pytest.importorskip("gsply.spz")
    c = moderate()
    spz.write(tmp_path / "c.spz", c, version)
    d = other.read_spz(tmp_path / "c.spz")
    np.testing.assert_allclose(d.means, c.x, atol=0.51 / 2**16)
    np.testing.assert_allclose(d.scales, np.log(c.scale), atol=0.51 / 16)
    assert np.abs((d.quats * c.quat).sum(axis=1)).min() > 1 - 1e-5
    np.testing.assert_allclose(d.sh0, c.sh[:, 0], atol=0.51 / 255 / 0.15)
    np.testing.assert_allclose(1 / (1 + np.exp(-d.opacities)), c.opacity, atol=0.51 / 255)
    np.testing.assert_allclose(np.reshape(d.shN, c.sh[:, 1:].shape), c.sh[:, 1:], atol=0.51 / 128)
    other.write_spz(tmp_path / "d.spz", d, version=version, fractional_bits=16)
    e, own = spz.read(tmp_path / "d.spz"), spz.read(tmp_path / "c.spz")
    for name in ("x", "quat", "scale", "opacity", "sh"):
        np.testing.assert_allclose(getattr(e, name), getattr(own, name), atol=1e-6)


@pytest.mark.parametrize("degree", [0, 1])
def test_version_4(tmp_path, degree):
    row = (*ROW[:5], tuple(range(120, 129)) if degree else ())
    c = spz.read(save(tmp_path, gaussian_files.spz4([row] * 9, PACK, degree=degree)))
    d = spz.read(save(tmp_path, gaussian_files.spz([row] * 9, degree=degree)))
    for name in ("x", "quat", "scale", "opacity", "sh"):
        np.testing.assert_array_equal(getattr(c, name), getattr(d, name))
    np.testing.assert_allclose(c.x[0], [1, -2, 1 / 4096])


def test_what_unpacks_version_4_comes_with_every_installation():
    """Not with an extra."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert any(name.startswith("zstandard>=") for name in project["dependencies"])
    assert "spz" not in project["optional-dependencies"]
