"""A .ksplat says what GaussianSplats3D writes: rows by hand at every level and degree."""

import struct

import numpy as np
import pytest

from tests.support import splat_containers
from vgmpi.gaussians.formats import registry
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb

QUAT = (0.5, -0.5, 0.5, 0.5)
RGBA = (255, 0, 51, 204)


def read(path, data):
    path.write_bytes(data)
    return registry.read(path)


def colors(degree, level):
    """Coefficients of a row as the file has them: reds, greens and blues of each degree."""
    count = 3 * (0, 3, 8)[degree]
    return list(range(0, 10 * count, 10)) if level == 2 else [0.125 * k for k in range(count)]


@pytest.mark.parametrize("degree", [0, 1, 2])
@pytest.mark.parametrize("level", [0, 1, 2])
def test_every_level_and_degree(tmp_path, level, degree):
    sh = colors(degree, level)
    x = (1.5, -2.0, 3.0) if level == 0 else (0, 32767, 65534)
    row = splat_containers.ksplat_row(level, x, (0.5, 0.25, 2.0), QUAT, RGBA, sh)
    if level == 0:
        section, start = splat_containers.ksplat_section(1, degree), b""
    else:  # a bucket of one at (10, 20, 30); half a block is 4
        section = splat_containers.ksplat_section(
            1, degree, buckets=(256, 0, 1), block=8.0, steps=32767
        )
        start = struct.pack("<I3f", 1, 10, 20, 30)
    head = splat_containers.ksplat_header(1, level=level, bounds=(-2.0, 3.0))
    got = read(tmp_path / "a.ksplat", head + section + start + row)
    want = [[1.5, -2, 3]] if level == 0 else [[6, 20, 34]]
    np.testing.assert_allclose(got.x, want, rtol=1e-12)
    np.testing.assert_array_equal(got.scale, [[0.5, 0.25, 2.0]])
    np.testing.assert_allclose(got.quat, [QUAT], rtol=1e-12)
    np.testing.assert_allclose(got.opacity, 0.8)
    np.testing.assert_allclose(got.sh[0, 0], dc_from_rgb(np.array([1, 0, 0.2])), rtol=1e-6)
    values = np.array(sh, np.float64)
    values = -2 + 5 * values / 255 if level == 2 else values
    first, later = values[:9].reshape(3, -1).T, values[9:].reshape(3, -1).T
    np.testing.assert_allclose(got.sh[0, 1:4], first.reshape(-1, 3), rtol=1e-6)
    np.testing.assert_allclose(got.sh[0, 4:9], later.reshape(-1, 3), rtol=1e-6)
    assert got.sh.shape[1] == (degree + 1) ** 2
    assert got.record.encoding == f".ksplat, version 0.1, compression level {level}"


def test_full_buckets_come_before_others_and_sections_follow_each_other(tmp_path):
    """Each row moves by the center of its own bucket; colors of both degrees stand together."""
    rows = [
        splat_containers.ksplat_row(1, (32767 + k, 32767, 32767), (1, 1, 1), QUAT, RGBA, [1.0] * 9)
        for k in range(7)
    ]
    lengths, centers = (
        struct.pack("<2I", 1, 2),
        struct.pack("<12f", *(100.0 * k for k in range(12))),
    )
    first = splat_containers.ksplat_section(7, 1, buckets=(2, 2, 2), block=2 * 32767.0)
    other_row = splat_containers.ksplat_row(1, (32767, 32767, 32767), (1, 1, 1), QUAT, RGBA)
    spare = bytes(24)  # room for a row that is not there
    other = splat_containers.ksplat_section(
        1, 0, capacity=2, buckets=(1, 1, 0), block=1.0, steps=32767
    )
    data = splat_containers.ksplat_header(8, sections=2, level=1) + first + other
    data += lengths + centers + b"".join(rows) + struct.pack("<3f", -1, -2, -3) + other_row + spare
    got = read(tmp_path / "a.ksplat", data)
    bucket = np.array([0, 0, 1, 1, 2, 3, 3])
    np.testing.assert_allclose(got.x[:7, 0], 300 * bucket + np.arange(7))
    np.testing.assert_allclose(got.x[:7, 2], 300 * bucket + 200)
    np.testing.assert_allclose(got.x[7], [-1, -2, -3])
    assert got.sh.shape == (8, 4, 3) and (got.sh[:7, 1:] == 1).all() and not got.sh[7, 1:].any()


def test_rows_of_many_blocks_find_their_buckets(tmp_path):
    """More rows than are decoded together."""
    n = 40_000
    row = np.dtype([("x", "<u2", 3), ("s", "<f2", 3), ("q", "<f2", 4), ("rgba", "u1", 4)])
    rows = np.zeros(n, row)
    rows["x"], rows["s"], rows["q"], rows["rgba"] = 32767, 1, QUAT, RGBA
    section = splat_containers.ksplat_section(n, buckets=(100, 300, 10_000), block=1.0)
    lengths = np.ones(10_000, "<u4")
    centers = np.repeat(np.arange(10_300, dtype="<f4"), 3)
    data = (
        splat_containers.ksplat_header(n, level=1) + section + lengths.tobytes() + centers.tobytes()
    )
    got = read(tmp_path / "a.ksplat", data + rows.tobytes())
    want = np.concatenate([np.repeat(np.arange(300), 100), np.arange(300, 10_300)])
    np.testing.assert_array_equal(got.x[:, 1], want)


def test_bounds_of_colors_that_are_not_given(tmp_path):
    section = splat_containers.ksplat_section(1, 1, buckets=(256, 0, 1), block=8.0)
    row = splat_containers.ksplat_row(2, (0, 0, 0), (1, 1, 1), QUAT, RGBA, [0, 255, 51] * 3)
    head = splat_containers.ksplat_header(1, level=2)
    got = read(tmp_path / "a.ksplat", head + section + struct.pack("<I3f", 1, 0, 0, 0) + row)
    np.testing.assert_allclose(got.sh[0, 1:, 0], [-1.5, 1.5, -0.9], rtol=1e-6)


def test_it_is_only_read(tmp_path):
    cloud = read(
        tmp_path / "a.ksplat",
        splat_containers.ksplat_header(1)
        + splat_containers.ksplat_section(1)
        + splat_containers.ksplat_row(0, (1, 2, 3), (1, 1, 1), QUAT, RGBA),
    )
    with pytest.raises(registry.GaussianFileError, match=r"only read: written are \.ply"):
        registry.write(tmp_path / "b.ksplat", cloud)
