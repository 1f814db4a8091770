"""Broken and hostile files: one clear line, at once, and no memory for what a header claims."""

import json
import re
import time

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.support import gaussian_files as written
from tests.support import hostile_containers, hostile_gaussians
from tests.support import splat_containers as containers
from tests.support.peak_memory import read_apart
from vgmpi.gaussians.formats import registry
from vgmpi.runtime import process_limits

CASES = hostile_gaussians.cases()
GOOD = {
    ".ply": [hostile_gaussians.GOOD, hostile_gaussians.PACKED],
    ".splat": [written.splat([hostile_gaussians.HONEST] * 3)],
    ".spz": [
        hostile_gaussians.SPZ_GOOD,
        hostile_gaussians.SPZ_EXTENDED,
        hostile_gaussians.SPZ4_GOOD,
        hostile_gaussians.SPZ4_EXTENDED,
    ],
} | {suffix: [data] for suffix, data in hostile_containers.GOOD.items()}

# reads the files of a folder; the peak memory is the kernel's, set back before each file
READ = """
import json, pathlib, sys, time
from tests.support import peak_memory
from vgmpi.gaussians.formats import registry
for path in sorted(pathlib.Path(sys.argv[1]).iterdir()):
    peak_memory.forget()
    begin = time.process_time()
    try:
        said = f"read {len(registry.read(path))}"
    except registry.GaussianFileError as error:
        said = str(error)
    seconds = time.process_time() - begin
    print(json.dumps([path.name, seconds, peak_memory.megabytes(), said]))
"""


def read_all(folder):
    """Name -> seconds, peak memory of the whole process [MB] and the words for every file of a
    folder, read one after the other by a process of its own."""
    rows = read_apart(READ, folder)
    return {name: (seconds, peak, said) for name, seconds, peak, said in rows}


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """Path, seconds, peak memory of the whole process [MB] and the words for every case."""
    folder = tmp_path_factory.mktemp("hostile")
    paths = {key: folder / f"{k:03}{key[0]}" for k, key in enumerate(CASES)}
    try:
        for key, path in paths.items():
            hostile_gaussians.make(path, CASES[key][0])
        found = read_all(folder)
    finally:
        for path in paths.values():
            path.unlink(missing_ok=True)  # some are large
    return {key: (str(path), *found[path.name]) for key, path in paths.items()}


@pytest.mark.parametrize("key", CASES, ids=" ".join)
def test_one_line_within_a_second_and_200_mb(measured, key):
    path, seconds, peak, said = measured[key]
    assert said.startswith(f"{path}: ") and "\n" not in said and len(said) < 400
    assert re.search(CASES[key][1], said)
    assert seconds < 1
    assert peak < 200


def test_damaged_text_and_lists_are_bounded(tmp_path):
    """Most of 200 damaged files are rejected; what is read is within the same bounds."""
    for k, data in enumerate(hostile_gaussians.damaged()):
        (tmp_path / f"{k:03}.ply").write_bytes(data)
    answers = read_all(tmp_path)
    assert len(answers) == 200
    for name, (seconds, peak, said) in answers.items():
        assert seconds < 1 and peak < 200, (name, said)
        assert re.fullmatch(r"read \d+", said) or said.startswith(f"{tmp_path / name}: "), said
        assert "\n" not in said and len(said) < 500
    rejected = [said.split(": ", 1)[1] for _, _, said in answers.values() if " " in said[5:]]
    assert len(rejected) >= 100 and len({re.sub(r"\W?\d.*", "", said) for said in rejected}) >= 10


def test_there_are_many_of_every_kind():
    kinds = [suffix for suffix, _ in CASES]
    assert min(kinds.count(suffix) for suffix in registry.KINDS) >= 10 and len(kinds) >= 60


@pytest.mark.parametrize("name", ["missing.ply", "missing.spz", "missing.splat", "."])
def test_no_file_and_a_folder(tmp_path, name):
    with pytest.raises(registry.GaussianFileError) as caught:
        registry.read(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)


def test_a_folder_with_the_name_of_a_file(tmp_path):
    (tmp_path / "a.ply").mkdir()
    with pytest.raises(registry.GaussianFileError, match="directory"):
        registry.read(tmp_path / "a.ply")


@pytest.mark.parametrize("name", ["cloud", "cloud.obj", "cloud.ply.gz"])
def test_an_unknown_kind(tmp_path, name):
    (tmp_path / name).write_bytes(hostile_gaussians.GOOD)
    with pytest.raises(registry.GaussianFileError, match=r"\.ply, \.splat, \.spz"):
        registry.read(tmp_path / name)


def test_the_good_ones_are_good(tmp_path):
    """The tables of cases spoil these: they must be readable before."""
    for suffix, counts in ((".ply", (2, 5)), (".splat", (3,)), (".spz", (50,) * 4), (".sog", (5,)),
                           (".glb", (4,)), (".ksplat", (5,))):  # fmt: skip
        path = tmp_path / f"GOOD{suffix.upper()}"
        for data, count in zip(GOOD[suffix], counts):
            path.write_bytes(data)
            assert len(registry.read(path)) == count


@settings(max_examples=400, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    case=st.sampled_from([(suffix, data) for suffix in GOOD for data in GOOD[suffix]]),
    cut=st.integers(0, 2000),
    changes=st.lists(st.tuples(st.integers(0, 1500), st.integers(0, 255)), max_size=4),
)
def test_any_damage_gives_a_cloud_or_the_one_error(tmp_path_factory, case, cut, changes):
    suffix, data = case
    damaged = bytearray(data[: max(len(data) - cut, 0)] if cut % 3 else data)
    for at, value in changes:
        if damaged:
            damaged[at % len(damaged)] = value
    path = tmp_path_factory.mktemp("damaged") / f"cloud{suffix}"
    path.write_bytes(damaged)
    try:
        cloud = registry.read(path)
    except registry.GaussianFileError as error:
        assert "\n" not in str(error)
    else:
        assert len(cloud) > 0
        assert np.isfinite(cloud.cov().astype(np.float32)).all()
        assert ((cloud.opacity >= 0) & (cloud.opacity <= 1)).all()


DAMAGED = 200  # files of each format


def damaged_files(suffix, data):
    """Files with flipped bits, other bytes, a missing end, and values changed in a JSON header."""
    rng = np.random.default_rng(7)
    start = 0 if suffix != ".ksplat" else 4096
    for k in range(DAMAGED):
        out = bytearray(data)
        if k % 4 == 0:
            out = out[: rng.integers(len(out))]
        elif k % 4 == 1:  # headers say most: half of the damage is there
            for _ in range(rng.integers(1, 9)):
                place = rng.integers(len(out) if k % 8 == 1 else 60)
                out[(start + place) % len(out)] ^= 1 << rng.integers(8)
        elif k % 4 == 2:
            place = rng.integers(len(out))
            out[place : place + 4] = rng.bytes(4)
        else:
            digits = [i for i, byte in enumerate(out) if chr(byte) in '0123456789[]{}":,']
            for place in rng.choice(digits, min(3, len(digits))):
                out[place] = rng.choice(list(b'0123456789-e[]{}":,.'))
        yield bytes(out)


def reframed(suffix, data):
    """Damage inside of the JSON header alone: archive, chunks and sums are right."""
    if suffix == ".glb":
        header = json.dumps(hostile_containers.HEADER).encode()
        return header, lambda text: containers.glb(text, hostile_containers.BINARY)
    header = json.dumps(hostile_containers.META).encode()
    return header, lambda text: containers.sog(text, hostile_containers.MEMBERS)


def read_or_one_line(path, data):
    """Read a damaged file; return the error, "" if it is a cloud."""
    path.write_bytes(data)
    begin = time.process_time()
    try:
        cloud = registry.read(path)
    except registry.GaussianFileError as error:
        said = str(error)
        assert said.startswith(f"{path}: ") and said.isprintable() and len(said) < 400
    else:
        said = ""
        assert len(cloud) and np.isfinite(cloud.x).all() and np.isfinite(cloud.sh).all()
    assert time.process_time() - begin < 1
    return said


@pytest.mark.parametrize("suffix", hostile_containers.GOOD)
def test_damaged_files_of_a_fixed_seed(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    good = hostile_containers.GOOD[suffix]
    said = [read_or_one_line(path, data) for data in damaged_files(suffix, good)]
    assert sum(map(bool, said)) > DAMAGED / 3


@pytest.mark.parametrize("suffix", [".glb", ".sog"])
def test_damaged_headers_of_a_fixed_seed(tmp_path, suffix):
    header, framed = reframed(suffix, hostile_containers.GOOD[suffix])
    path = tmp_path / f"a{suffix}"
    said = [read_or_one_line(path, framed(text)) for text in damaged_files(suffix, header)]
    assert sum(map(bool, said)) > DAMAGED / 3


@pytest.mark.parametrize(
    "suffix, says",
    [(".lcc", "LCC"), (".rad", "RAD"), (".4dgs", "4DGS"), (".splat4d", "4DGS"), (".json", "SOG")],
)
def test_formats_that_are_not_read_are_named_with_the_way(tmp_path, suffix, says):
    (tmp_path / f"a{suffix}").write_bytes(b"anything")
    with pytest.raises(registry.GaussianFileError, match=f"{says}.*convert it to .ply"):
        registry.read(tmp_path / f"a{suffix}")


@pytest.mark.parametrize("suffix", GOOD)
def test_what_does_not_fit_is_told_with_the_first_rows(tmp_path, monkeypatch, suffix):
    path = tmp_path / f"cloud{suffix}"
    path.write_bytes(GOOD[suffix][0])
    count = len(registry.read(path))
    for free in (100 * count, 1000 * count):  # bytes: two thirds and six times what they take
        monkeypatch.setattr(process_limits, "available_memory", lambda swap=False, free=free: free)
        if free > 500 * count:
            assert len(registry.read(path)) == count
        else:
            with pytest.raises(registry.GaussianFileError, match=f"its {count} Gaussians take at"):
                registry.read(path)
