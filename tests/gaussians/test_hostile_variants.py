"""Two hundred damaged files of every variant of a format that is read: versions, encodings, levels,
and a .gltf with its buffer beside it. One line or a cloud, within a second and 200 MB."""

import json
import re

import numpy as np
import pytest

from tests.gaussians.test_hostile import DAMAGED, damaged_files, read_all
from tests.support import gaussian_files as written
from tests.support import hostile_containers, hostile_gaussians, splat_containers

ROW = hostile_gaussians.SPZ_ROW
SMALLEST = (*ROW[:4], (128, 128, 128), *ROW[5:])  # versions 1 and 2 have rotations of three bytes
HALVES = ((1.5, -2.0, 0.25), *SMALLEST[1:])
COLUMNS = written.columns(n=40, rest=9, label=("uchar", list(range(40))))


def gltf(uri):
    """A .gltf whose buffer is the file `uri`."""
    length = len(hostile_containers.BINARY)
    header = hostile_containers.HEADER | {"buffers": [{"byteLength": length, "uri": uri}]}
    return json.dumps(header).encode()


def ksplat(level):
    """Five Gaussians of degree 0, of one full bucket above level 0."""
    rng = np.random.default_rng(level)
    x = rng.random((5, 3)) if level == 0 else rng.integers(30000, 35000, (5, 3))
    rows = [
        splat_containers.ksplat_row(level, p, (0.1, 0.2, 0.3), (1, 0, 0, 0), (9, 8, 7, 200))
        for p in x
    ]
    if level == 0:
        return (
            splat_containers.ksplat_header(5) + splat_containers.ksplat_section(5) + b"".join(rows)
        )
    head = splat_containers.ksplat_section(5, buckets=(5, 1, 0), block=5.0, steps=32767)
    center = np.array([1, 2, 3], "<f4").tobytes()
    return splat_containers.ksplat_header(5, level=level) + head + center + b"".join(rows)


SOG_1, MEMBERS_1, _ = splat_containers.sog_members(version=1)
GOOD = {
    "text": (".ply", written.table(COLUMNS, "ascii")),
    "little-endian": (".ply", written.table(COLUMNS, "<")),
    "big-endian": (".ply", written.table(COLUMNS, ">")),
    "compressed": (".ply", hostile_gaussians.PACKED),
    "antimatter15": (".splat", written.splat([hostile_gaussians.HONEST] * 40)),
    "version 1": (".spz", written.spz([HALVES] * 50, version=1)),
    "version 2": (".spz", written.spz([SMALLEST] * 50, version=2)),
    "version 3": (".spz", hostile_gaussians.SPZ_GOOD),
    "version 4": (".spz", hostile_gaussians.SPZ4_GOOD),
    "without a version": (".sog", splat_containers.sog(SOG_1, MEMBERS_1)),
    "with a version": (".sog", hostile_containers.SOG_GOOD),
    "one file": (".glb", hostile_containers.GLB_GOOD),
    "two files": (".gltf", gltf("good.bin")),
    "level 0": (".ksplat", ksplat(0)),
    "level 1": (".ksplat", ksplat(1)),
    "level 2": (".ksplat", ksplat(2)),
    "with colors": (".ksplat", hostile_containers.KSPLAT_GOOD),
}


def check_answers(folder, suffix, min_rejected):
    """Read the files of a folder; return how many were rejected."""
    answers = {name: a for name, a in read_all(folder).items() if name.endswith(suffix)}
    assert len(answers) == DAMAGED + 1
    for name, (seconds, peak, said) in answers.items():
        assert seconds < 1 and peak < 200, (name, said)
        assert re.fullmatch(r"read \d+", said) or said.startswith(f"{folder / name}: "), said
        assert said.isprintable() and len(said) < 500
    assert re.fullmatch(r"read \d+", answers[f"good{suffix}"][2])
    assert sum(" " in said[5:] for _, _, said in answers.values()) >= min_rejected


@pytest.mark.parametrize("variant", GOOD)
def test_damaged_files_of_every_variant(tmp_path, variant):
    suffix, data = GOOD[variant]
    (tmp_path / f"good{suffix}").write_bytes(data)
    (tmp_path / "good.bin").write_bytes(hostile_containers.BINARY)
    for k, damaged in enumerate(damaged_files(suffix, data)):
        (tmp_path / f"{k:03}{suffix}").write_bytes(damaged)
    check_answers(tmp_path, suffix, DAMAGED // 5)


def test_damaged_buffers_beside_a_gltf(tmp_path):
    for k, damaged in enumerate(damaged_files(".bin", hostile_containers.BINARY)):
        (tmp_path / f"{k:03}.bin").write_bytes(damaged)
        (tmp_path / f"{k:03}.gltf").write_bytes(gltf(f"{k:03}.bin"))
    (tmp_path / "good.gltf").write_bytes(gltf("good.bin"))
    (tmp_path / "good.bin").write_bytes(hostile_containers.BINARY)
    check_answers(tmp_path, ".gltf", DAMAGED // 5)
