"""Damaged .spz files of version 4 and with extension records: one line, at once, no memory."""

import random
import re
import struct

import pytest

from tests.gaussians.test_hostile import read_all
from tests.support import gaussian_files, hostile_gaussians
from vgmpi.gaussians.formats import registry

COUNT, SEED = 200, 2607
GOOD = (
    hostile_gaussians.SPZ4_GOOD,
    hostile_gaussians.SPZ4_EXTENDED,
    hostile_gaussians.SPZ_EXTENDED,
)


def damaged(number, chance):
    """One of the good files with a cut, wrong bytes, or a wrong number of 4 or 8 bytes."""
    data = bytearray(GOOD[number % len(GOOD)])
    kind = number // len(GOOD) % 4
    if kind == 0:
        return bytes(data[: chance.randrange(len(data))])
    if kind == 1:
        for _ in range(chance.randint(1, 8)):
            data[chance.randrange(len(data))] = chance.randrange(256)
    else:
        form = "<I" if kind == 2 else "<Q"
        size = struct.calcsize(form)
        value = chance.choice([0, 1, 2**31, 2 ** (8 * size) - 1, chance.getrandbits(8 * size)])
        struct.pack_into(form, data, chance.randrange(min(150, len(data)) - size), value)
    return bytes(data)


def test_damaged_files_of_a_fixed_seed(tmp_path):
    chance = random.Random(SEED)
    for number in range(COUNT):
        (tmp_path / f"{number:03}.spz").write_bytes(damaged(number, chance))
    found = read_all(tmp_path)
    assert len(found) == COUNT
    refused = 0
    for name, (seconds, peak, said) in found.items():
        assert "\n" not in said and len(said) < 400
        assert seconds < 1 and peak < 200
        if not re.fullmatch(r"read \d+", said):
            assert said.startswith(f"{tmp_path / name}: ")
            refused += 1
    assert refused > COUNT // 2


def test_endless_records_take_neither_memory_nor_time(tmp_path):
    """Half a gigabyte of zeros behind the Gaussians is a file of half a megabyte."""
    hostile_gaussians.spz_bomb(tmp_path / "a.spz", 1, 500 << 20, flags=2)
    many = struct.pack("<II", 7, 0) * (4 << 20)
    row = hostile_gaussians.SPZ_ROW
    data = gaussian_files.spz4([row], hostile_gaussians.ZSTD, records=many, flags=2)
    (tmp_path / "b.spz").write_bytes(data)
    long = struct.pack("<II", 7, 2**32 - 1)
    data = gaussian_files.spz4([row], hostile_gaussians.ZSTD, records=long, flags=2)
    (tmp_path / "c.spz").write_bytes(data)
    found = read_all(tmp_path)
    for name in ("a.spz", "b.spz", "c.spz"):
        seconds, peak, said = found[name]
        assert said == "read 1" and seconds < 1 and peak < 200


def test_many_kinds_of_records_are_told_in_a_short_line(tmp_path):
    records = b"".join(struct.pack("<II", kind, 0) for kind in range(1, 5000))
    path = tmp_path / "a.spz"
    row = hostile_gaussians.SPZ_ROW
    path.write_bytes(gaussian_files.spz([row], records=records, flags=2))
    (omission,) = registry.read(path).record.omissions
    assert omission == "extension records are left out (0x00000001, 0x00000002, 0x00000003)"


@pytest.mark.parametrize("data", GOOD, ids=range(len(GOOD)))
def test_what_is_damaged_here_is_good(tmp_path, data):
    (tmp_path / "a.spz").write_bytes(data)
    assert len(registry.read(tmp_path / "a.spz")) == 50
