"""Broken and hostile files: one clear line, and no memory for what a header merely claims."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.gaussians import files
from vgmpi.gaussians import ply

GOOD = files.plain([files.row(), files.row(x=(4, 5, 6))])
_RNG = np.random.default_rng(0)
PACKED = files.compressed(
    _RNG.normal(size=(5, 3)),
    _RNG.normal(size=(5, 4)),
    _RNG.normal(size=(5, 3)),
    _RNG.random((5, 3)),
    _RNG.random(5),
)
VERTEX = [("float", name) for name in files.names()]
CHUNK = [("float", name) for name in files.BOUNDS]
WORDS = [("uint", name) for name in files.PACKED]


def one_bad(**changes):
    return files.plain([files.row(), files.row(**changes)])


def with_header(*elements, data=b"\0" * 4096, form="binary_little_endian"):
    return files.header(elements, form) + data


BAD = {
    "empty": (b"", "does not begin with 'ply'"),
    "a picture": (b"\x89PNG\r\n\x1a\n" + bytes(100), "does not begin with 'ply'"),
    "no end of the header": (b"ply\nformat binary_little_endian 1.0\n", "no end"),
    "an endless header": (b"ply\n" + b"comment x\n" * 20000, "no end"),
    "text": (GOOD.replace(b"binary_little_endian", b"ascii"), "binary"),
    "no format": (b"ply\nelement vertex 1\nproperty float x\nend_header\n    ", "format"),
    "a half of it": (GOOD[:-1], "truncated"),
    "the header only": (GOOD[: GOOD.index(b"end_header") + 11], "truncated"),
    "a huge count": (GOOD.replace(b"vertex 2", b"vertex 900000000000"), "truncated"),
    "an absurd count": (GOOD.replace(b"vertex 2", b"vertex " + b"9" * 30), "number of rows"),
    "a negative count": (GOOD.replace(b"vertex 2", b"vertex -2"), "number of rows"),
    "a worded count": (GOOD.replace(b"vertex 2", b"vertex two"), "number of rows"),
    "nothing in it": (files.plain([]), "no Gaussians"),
    "no vertices": (with_header(("face", 1, [("float", "x")])), "vertex"),
    "a mesh": (
        with_header(("vertex", 1, [("float", n) for n in "xyz"])).replace(
            b"end_header", b"element face 1\nproperty list uchar int vertex_index\nend_header"
        ),
        "lists",
    ),
    "a list in the vertices": (
        GOOD.replace(b"property float nx", b"property list uchar float nx"),
        "lists",
    ),
    "points": (with_header(("vertex", 1, [("float", n) for n in "xyz"])), "rot_0"),
    "an unknown type": (GOOD.replace(b"float nx", b"half nx"), "header line"),
    "a property before any element": (
        GOOD.replace(b"element vertex 2\n", b""),
        "header line",
    ),
    "a name twice": (GOOD.replace(b"float ny", b"float nx"), "repeated"),
    "an element twice": (with_header(("vertex", 1, VERTEX), ("vertex", 1, VERTEX)), "twice"),
    "an element without properties": (with_header(("vertex", 10**12, [])), "no or repeated"),
    "an odd number of colours": (
        with_header(("vertex", 1, VERTEX + [("float", f"f_rest_{i}") for i in range(10)])),
        "10 f_rest",
    ),
    "misnumbered colours": (
        with_header(("vertex", 1, VERTEX + [("float", f"f_rest_{i + 1}") for i in range(9)])),
        "f_rest_0",
    ),
    "not a number": (one_bad(x=(0, np.nan, 0)), "row 1"),
    "infinite": (one_bad(x=(0, 0, np.inf)), "not finite"),
    "a scale beyond all bounds": (one_bad(scale=(0, 0, 1e4)), "not finite"),
    "no rotation": (one_bad(rot=(0, 0, 0, 0)), "no rotation"),
    "an infinite rotation": (one_bad(rot=(np.inf, 0, 0, 0)), "row 1"),
    "a colour that is no number": (one_bad(color=(0, np.nan, 0)), "row 1"),
    "an opacity that is no number": (one_bad(opacity=np.nan), "row 1"),
    "packed and short": (PACKED[:-1], "truncated"),
    "packed without chunks": (with_header(("vertex", 5, WORDS)), "0 chunks"),
    "packed with too few chunks": (
        with_header(("chunk", 1, CHUNK), ("vertex", 257, WORDS), data=bytes(8192)),
        "1 chunks for 257",
    ),
    "chunks without bounds": (
        with_header(("chunk", 1, CHUNK[1:]), ("vertex", 5, WORDS)),
        "min_x",
    ),
    "packed as floats": (
        with_header(("chunk", 1, CHUNK), ("vertex", 5, [("float", n) for n in files.PACKED])),
        "packed_position",
    ),
    "packed colours for others": (
        with_header(
            ("chunk", 1, CHUNK),
            ("vertex", 5, WORDS),
            ("sh", 4, [("uchar", f"f_rest_{i}") for i in range(9)]),
        ),
        "4 rows of 'sh'",
    ),
    "bounds that are no numbers": (
        files.header([("chunk", 1, CHUNK), ("vertex", 5, WORDS)])
        + np.full(12, np.nan, "<f4").tobytes()
        + bytes(80),
        "not finite",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_in_one_line(tmp_path, name):
    data, says = BAD[name]
    path = tmp_path / "bad.ply"
    path.write_bytes(data)
    tracemalloc.start()
    with pytest.raises(ply.GaussianFileError) as caught:
        ply.read(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    text = str(caught.value)
    assert text.startswith(f"{path}: ") and "\n" not in text
    assert says in text
    assert peak < 20e6


@pytest.mark.parametrize("name", ["missing.ply", "."])
def test_no_file_and_a_folder(tmp_path, name):
    with pytest.raises(ply.GaussianFileError) as caught:
        ply.read(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)


def test_the_good_ones_are_good(tmp_path):
    """The table above spoils these: they must be readable before."""
    for data, count in ((GOOD, 2), (PACKED, 5)):
        (tmp_path / "good.ply").write_bytes(data)
        assert len(ply.read(tmp_path / "good.ply")) == count


@settings(max_examples=300, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    data=st.sampled_from([GOOD, PACKED]),
    cut=st.integers(0, 2000),
    changes=st.lists(st.tuples(st.integers(0, 1500), st.integers(0, 255)), max_size=4),
)
def test_any_damage_gives_a_cloud_or_the_one_error(tmp_path_factory, data, cut, changes):
    damaged = bytearray(data[: max(len(data) - cut, 0)] if cut % 3 else data)
    for at, value in changes:
        if damaged:
            damaged[at % len(damaged)] = value
    path = tmp_path_factory.mktemp("damaged") / "cloud.ply"
    path.write_bytes(damaged)
    try:
        cloud = ply.read(path)
    except ply.GaussianFileError as error:
        assert "\n" not in str(error)
    else:
        assert len(cloud) > 0
        assert np.isfinite(cloud.cov()).all() or np.abs(cloud.scale).max() > 1e100
        assert ((cloud.opacity >= 0) & (cloud.opacity <= 1)).all()
