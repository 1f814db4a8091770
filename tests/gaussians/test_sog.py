"""A .sog says what its specification says: values by hand, by another reader and by the writer."""

import io
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support import splat_containers
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.formats import registry, sog


def cloud(n=300, terms=16, seed=1, **more):
    rng = np.random.default_rng(seed)
    quat = rng.normal(size=(n, 4))
    quat /= np.linalg.norm(quat, axis=1)[:, None]
    return GaussianCloud(
        rng.normal(size=(n, 3)) * [5, 1, 20],
        quat,
        np.exp(rng.uniform(-5, 0, (n, 3))),
        rng.uniform(0, 1, n),
        rng.normal(0, 0.3, (n, terms, 3)).astype("f4"),
        **more,
    )


def read(path, data):
    path.write_bytes(data)
    return registry.read(path)


def unlog(values):
    """Inverse of sign(x) log(1 + |x|)."""
    values = np.asarray(values, np.float64)
    return np.sign(values) * (np.exp(np.abs(values)) - 1)


def test_version_2_by_hand(tmp_path):
    meta, members, pixels = splat_containers.sog_members()
    got = read(tmp_path / "a.sog", splat_containers.sog(meta, members))
    assert len(got) == 5 and got.sh.shape == (5, 4, 3)
    assert got.record.encoding == ".sog, version 2" and not got.is_antialiased
    # Gaussian 2: the third pixel; low bytes 2, 20, 253; high bytes 0, 80, 155
    steps = np.array([2, 20 + 256 * 80, 253 + 256 * 155]) / 65535
    want = unlog(np.array([-1, 0, -3]) + steps * np.array([2, 2, 3.5]))
    np.testing.assert_allclose(got.x[2], want, rtol=1e-12)
    np.testing.assert_allclose(got.scale[2], np.exp(-6 + 6 * np.array([2, 3, 4]) / 255), rtol=1e-12)
    np.testing.assert_allclose(got.opacity[2], 102 / 255)
    np.testing.assert_allclose(got.sh[2, 0], -2 + 4 * np.array([4, 6, 8]) / 255, rtol=1e-6)
    # the leading component is y (number 2): w, x and z stand in the picture
    w, x, z = (np.array([102, 128, 148]) / 255 * 2 - 1) / np.sqrt(2)
    y = np.sqrt(1 - w * w - x * x - z * z)
    np.testing.assert_allclose(got.quat[2], [w, x, y, z], atol=1e-12)
    # entry 66: the third of the second row, three pixels from column 6
    codes = pixels["centroids.webp"][1, 6:9, :3] / 255
    np.testing.assert_allclose(got.sh[2, 1:], -1 + 2 * codes, rtol=1e-5, atol=1e-6)


def test_version_1_by_hand(tmp_path):
    """Bounds instead of codebooks; the opacity is a logit."""
    meta, members, pixels = splat_containers.sog_members(version=1)
    got = read(tmp_path / "a.sog", splat_containers.sog(meta, members))
    assert len(got) == 5 and got.record.encoding == ".sog, version 1"
    k = np.array([3, 4, 5]) / 255
    np.testing.assert_allclose(
        got.scale[3], np.exp([-6, -5, -4] + np.array([6, 4, 2]) * k), rtol=1e-12
    )
    np.testing.assert_allclose(got.opacity[3], 1 / (1 + np.exp(5 - 10 * 153 / 255)), rtol=1e-12)
    dc = [-2, -1, -1.5] + np.array([4, 2, 3]) * np.array([6, 9, 12]) / 255
    np.testing.assert_allclose(got.sh[3, 0], dc, rtol=1e-6)
    codes = pixels["centroids.webp"][0, 6:9, :3] / 255
    np.testing.assert_allclose(got.sh[3, 1:], -1 + 2 * codes, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("terms", [1, 4, 9, 16])
def test_what_the_writer_wrote_comes_back(tmp_path, terms):
    """In the order of the file, along a Morton curve."""
    before = cloud(terms=terms)
    registry.write(tmp_path / "a.sog", before)
    got = registry.read(tmp_path / "a.sog")
    row = np.linalg.norm(got.x[:, None] - before.x, axis=2).argmin(axis=1)
    assert sorted(row) == list(range(len(before)))
    want = before.select(row)
    logs = [np.sign(c.x) * np.log1p(np.abs(c.x)) for c in (got, want)]
    step = np.ptp(logs[1], axis=0) / 65535
    assert (np.abs(logs[0] - logs[1]) <= 0.501 * step).all()
    np.testing.assert_allclose(got.scale, want.scale, rtol=0.02)  # 256 sizes for 900
    np.testing.assert_allclose(got.opacity, want.opacity, atol=0.5 / 255 + 1e-9)
    assert np.abs((got.quat * want.quat).sum(axis=1)).min() > 0.9999
    np.testing.assert_allclose(got.sh, want.sh, atol=0.05)
    assert got.sh.shape == want.sh.shape


def test_another_reader_finds_the_same_numbers(tmp_path, monkeypatch):
    gsply = pytest.importorskip("gsply", reason="needs gsply: pip install 'vgmpi[test]'")
    from gsply import sog_reader as theirs
    from PIL import Image

    def webp_decode(data):
        return np.array(Image.open(io.BytesIO(data)).convert("RGBA"))

    monkeypatch.setattr(theirs, "imagecodecs", SimpleNamespace(webp_decode=webp_decode))
    registry.write(tmp_path / "a.sog", cloud())
    got, want = registry.read(tmp_path / "a.sog"), gsply.sog_reader.sogread(tmp_path / "a.sog")
    np.testing.assert_allclose(got.x, want.means, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(got.scale, np.exp(want.scales), rtol=1e-5)
    np.testing.assert_allclose(got.sh[:, 0], want.sh0, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(got.sh[:, 1:], want.shN, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    "change, is_antialiased, says",
    [
        ({}, False, ""),
        ({"model": "default"}, False, ""),
        ({"model": "antialiased"}, True, "model"),
        ({"antialias": True}, True, "antialias"),
        ({"antialias": False}, False, ""),
        ({"model": "2dgs"}, False, ""),
    ],
)
def test_how_it_was_trained_is_told(tmp_path, change, is_antialiased, says):
    meta, members, _ = splat_containers.sog_members()
    got = read(tmp_path / "a.sog", splat_containers.sog(meta | change, members))
    assert got.is_antialiased is is_antialiased
    assert says in got.record.render_model_source
    assert bool(got.record.render_model_source) is is_antialiased
    assert any("2DGS" in doubt for doubt in got.record.doubts) is (change.get("model") == "2dgs")


@pytest.mark.parametrize("is_antialiased", [False, True])
def test_the_writer_tells_how_it_was_trained(tmp_path, is_antialiased):
    registry.write(tmp_path / "a.sog", cloud(is_antialiased=is_antialiased))
    assert registry.read(tmp_path / "a.sog").is_antialiased is is_antialiased


def test_the_program_that_made_it_is_told(tmp_path):
    meta, members, _ = splat_containers.sog_members()
    got = read(
        tmp_path / "a.sog",
        splat_containers.sog({"asset": {"generator": "x 1.0\n"}} | meta, members),
    )
    assert got.record.comments == ("generator: x 1.0",)


def test_degree_4_is_left_out_and_told(tmp_path):
    meta, members, pixels = splat_containers.sog_members()
    centroids = np.zeros((1, 64 * 24, 3), np.uint8)
    centroids[0, 24:48] = np.arange(24)[:, None]  # of entry 1
    members["centroids.webp"] = splat_containers.webp(centroids)
    meta["shN"] |= {"bands": 4, "count": 64}
    members["labels.webp"] = splat_containers.webp(np.full((2, 3, 3), [1, 0, 0]))
    got = read(tmp_path / "a.sog", splat_containers.sog(meta, members))
    assert got.sh.shape == (5, 16, 3) and got.record.omissions == (
        "colors of degree 4 are left out, the highest is 3",
    )
    np.testing.assert_allclose(got.sh[4, 1:, 0], -1 + 2 * np.arange(15) / 255, rtol=1e-5)


def test_invalid_rows_are_dropped(tmp_path):
    """A rotation without a leading component, and a color that is not in the palette."""
    n = 1000
    meta, members, _ = splat_containers.sog_members(n=n)
    meta["means"]["files"] = ["a.webp", "a.webp"]
    for key in ("scales", "sh0"):
        meta[key]["files"] = ["a.webp"]
    quats, labels = np.zeros((25, 40, 4), np.uint8), np.zeros((25, 40, 4), np.uint8)
    quats[..., 3], labels[..., 3] = 253, 255
    quats[0, 7, 3] = 251
    labels[1, 3, 0] = 70  # of 70 entries
    members["q.webp"], members["labels.webp"] = (
        splat_containers.webp(quats),
        splat_containers.webp(labels),
    )
    members["a.webp"] = splat_containers.webp(np.full((25, 40, 4), 77))
    got = read(tmp_path / "a.sog", splat_containers.sog(meta, members))
    assert len(got) == n - 2
    assert got.record.omissions[0].startswith("2 of 1,000 Gaussians are not finite")


def test_a_deflated_archive_and_png_pictures_are_read(tmp_path):
    from PIL import Image

    meta, members, pixels = splat_containers.sog_members()
    want = read(tmp_path / "a.sog", splat_containers.sog(meta, members))
    data = io.BytesIO()
    Image.fromarray(pixels["c.webp"].reshape(2, 3, 4).astype(np.uint8)).save(data, "png")
    members["c.webp"] = data.getvalue()
    got = read(
        tmp_path / "b.sog",
        splat_containers.sog(meta, members, splat_containers.zipfile.ZIP_DEFLATED),
    )
    np.testing.assert_array_equal(got.sh, want.sh)
    np.testing.assert_array_equal(got.opacity, want.opacity)


@pytest.mark.parametrize("lossless", [True, False])
@pytest.mark.parametrize("alpha", [3, 4])
def test_the_size_of_a_picture_is_known_from_its_header(lossless, alpha):
    picture = np.full((37, 1211, alpha), 9)
    picture[..., -1] = 100
    assert sog._webp_size(splat_containers.webp(picture, lossless)) == (1211, 37)
