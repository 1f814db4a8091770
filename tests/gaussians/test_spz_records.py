"""Extension records of .spz files: which frame a file names, by the format's own page."""

import gzip
import struct

import numpy as np
import pytest
import zstandard

from tests.gaussians.test_spz import PACK, ROW, moderate, save
from tests.support import gaussian_files
from vgmpi.gaussians.capture_conventions import capture_notes
from vgmpi.gaussians.formats import registry, spz

FRAME = 0xADBE0003
ORBIT = struct.pack("<IIfff", 0xADBE0002, 12, -0.5, 0.5, 1.0)  # a camera's limits
# enum CoordinateSystem of nianticlabs/spz
NUMBERS = {
    "LDB": 1, "RDB": 2, "LUB": 3, "RUB": 4, "LDF": 5, "RDF": 6, "LUF": 7, "RUF": 8,
    "LFD": 9, "RFD": 10, "LFU": 11, "RFU": 12, "LBD": 13, "RBD": 14, "LBU": 15, "RBU": 16,
}  # fmt: skip
FILE = (1.0, -2.0, 1 / 4096)  # the center in the file
BUILD = {
    3: lambda rows, **header: gaussian_files.spz(rows, **header),
    4: lambda rows, **header: gaussian_files.spz4(rows, PACK, **header),
}


def frame_record(number):
    return struct.pack("<III", FRAME, 4, number)


def directed(frame, vector):
    """A vector of a frame as right, down, forward."""
    return [
        sum(v * (1 if letter == a else -1) for letter, v in zip(frame, vector) if letter in (a, b))
        for a, b in ("RL", "DU", "FB")
    ]


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("frame", NUMBERS)
def test_the_frame_that_a_file_names_is_obeyed(tmp_path, frame, version):
    data = BUILD[version]([ROW], flags=2, records=frame_record(NUMBERS[frame]))
    path = save(tmp_path, data)
    assert spz.read(path).record.frame == frame
    np.testing.assert_allclose(spz.read(path).x, [FILE])  # the reader itself turns nothing
    c = registry.read(path)
    np.testing.assert_allclose(c.x, [directed(frame, FILE)])
    turned = "" if frame == "RDF" else ", turned to RDF"
    assert capture_notes(c) == [f"frame {frame}: said by the file's record{turned}"]


@pytest.mark.parametrize("version", [1, 2, 3, 4])
def test_numbers_are_taken_as_they_are_without_a_record(tmp_path, version):
    if version < 4:
        x = (1.0, -2.0, 0.25) if version == 1 else (4096, -8192, 1024)
        quat = (0, 0, 0, 192) if version == 3 else (128, 128, 128)
        data = gaussian_files.spz([(x, *ROW[1:4], quat, ())], version=version)
    else:
        data = gaussian_files.spz4([((4096, -8192, 1024), *ROW[1:])], PACK)
    c = registry.read(save(tmp_path, data))
    np.testing.assert_array_equal(c.x, [[1, -2, 0.25]])
    assert capture_notes(c) == ["frame taken as in a .ply, the file does not say"]


@pytest.mark.parametrize("version", [3, 4])
def test_the_key_wins_over_the_record(tmp_path, version):
    path = save(tmp_path, BUILD[version]([ROW], flags=2, records=frame_record(NUMBERS["RUB"])))
    c = registry.read(path, "RDF")
    np.testing.assert_allclose(c.x, [FILE])
    (note,) = capture_notes(c)
    assert note == "frame RDF: named by the key frame, although the file says RUB"
    c = registry.read(path, "RUB")
    np.testing.assert_allclose(c.x, [directed("RUB", FILE)])
    assert capture_notes(c) == ["frame RUB: named by the key frame, turned to RDF"]


@pytest.mark.parametrize("version", [3, 4])
def test_written_files_name_their_frame(tmp_path, version):
    """Flag 2, and a record of number 6: behind the data of version 3, ahead of the table of 4."""
    c = moderate(5)
    registry.write(tmp_path / "c.spz", c, version)
    data = (tmp_path / "c.spz").read_bytes()
    if version == 3:
        data = gzip.decompress(data)
        record = data[-12:]
        assert len(data) == 16 + 5 * (9 + 1 + 3 + 3 + 4 + 45) + 12
    else:
        record = data[32:44]
        assert struct.unpack_from("<I", data, 16) == (44,)
    assert data[:4] == b"NGSP" and struct.unpack_from("<I", data, 4) == (version,)
    assert data[14] == 2 and record == frame_record(6)
    d = registry.read(tmp_path / "c.spz")
    assert np.abs(d.x - c.x).max() <= 0.5 / 2**16
    assert capture_notes(d) == ["frame RDF: said by the file's record"]


def test_the_streams_of_version_4_are_those_of_the_page(tmp_path):
    """A table of packed and unpacked sizes, then zstd streams in the order of the attributes."""
    registry.write(tmp_path / "c.spz", moderate(5, k=4), 4)
    data = (tmp_path / "c.spz").read_bytes()
    assert data[15] == 6 and data[20:32] == bytes(12)
    start = 44 + 6 * 16
    for k, row_bytes in enumerate((9, 1, 3, 3, 4, 9)):
        packed, size = struct.unpack_from("<QQ", data, 44 + 16 * k)
        assert size == 5 * row_bytes
        assert len(zstandard.ZstdDecompressor().decompress(data[start : start + packed])) == size
        start += packed
    assert start == len(data)


@pytest.mark.parametrize("version", [3, 4])
def test_other_records_are_skipped_and_told(tmp_path, version):
    records = ORBIT + struct.pack("<II", 0x12340001, 0) + frame_record(4) + frame_record(6)
    c = registry.read(save(tmp_path, BUILD[version]([ROW], flags=2, records=records)))
    np.testing.assert_allclose(c.x, [directed("RUB", FILE)])  # the first record of the frame
    assert capture_notes(c)[1:] == ["extension records are left out (0x12340001, 0xADBE0002)"]


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize(
    "records, doubt",
    [
        (frame_record(0), "its record of the frame has the unknown number 0"),
        (frame_record(17), "its record of the frame has the unknown number 17"),
        (struct.pack("<IIH", FRAME, 2, 4), "its record of the frame has the unknown number 0"),
        (b"", "its extension records are missing or cut off"),
        (bytes(range(16)), "its extension records are missing or cut off"),
        (frame_record(4)[:-1], "its extension records are missing or cut off"),
        (ORBIT + b"x", "its extension records are missing or cut off"),
        (struct.pack("<II", 1, 2**32 - 1), "its extension records are missing or cut off"),
    ],
)
def test_records_that_say_nothing_leave_the_numbers_and_a_doubt(tmp_path, version, records, doubt):
    c = registry.read(save(tmp_path, BUILD[version]([ROW], flags=2, records=records)))
    np.testing.assert_allclose(c.x, [FILE])
    assert c.record.doubts == (doubt,)
    assert capture_notes(c)[0] == "frame taken as in a .ply, the file does not say"


def test_records_without_their_flag_are_no_records(tmp_path):
    """Ahead of the table of version 4 may be anything, behind the data of version 3 nothing."""
    c = registry.read(save(tmp_path, gaussian_files.spz4([ROW], PACK, records=frame_record(4))))
    np.testing.assert_allclose(c.x, [FILE])
    with pytest.raises(registry.GaussianFileError, match="holds more than its 1 Gaussians"):
        registry.read(save(tmp_path, gaussian_files.spz([ROW], records=frame_record(4))))
