"""Files of this program are read by others as by itself, and the files of others are the .ply that
they were made of: the same numbers in the axes of the .ply, to the bits that a format has.

The other programs are in the folder VGMPI_SPLAT_TOOLS: tests/support/install_splat_tools.sh.
"""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support import splat_converters as programs
from tests.support.splat_comparison import (
    BYTE,
    COUNT,
    FLOAT,
    KSPLAT,
    KSPLAT_1,
    KSPLAT_2,
    SINGLE,
    SPLAT,
    SPZ,
    SPZ_5,
    SPZ_12,
    check_bound,
    check_same,
    cloud,
    columns_of,
    covariances,
    in_order_of,
    steps_of_compressed,
    steps_of_sog,
)
from vgmpi.gaussians.cloud import pack_symmetric, rotation_matrices, unpack_symmetric
from vgmpi.gaussians.formats import motion_stream as layout
from vgmpi.gaussians.formats import registry
from vgmpi.gaussians.spherical_harmonics import C0
from vgmpi.postprocess.export.usd_stage import UsdStage

needs_tools = pytest.mark.skipif(
    programs.tools_folder() is None,
    reason=f"needs {', '.join(programs.VERSIONS)}: VGMPI_SPLAT_TOOLS=FOLDER as"
    " tests/support/install_splat_tools.sh FOLDER makes it",
)
DEGREES = (0, 1, 2, 3)
HALF_TURN_ABOUT_Z = [-1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1]  # (-1)^m of each term

# what reads a file, beside this program; "-3" and "-4" are versions of .spz
READERS = {
    ".ply": ("splat-transform", "gsply", "gaussforge", "spz-js"),
    ".compressed.ply": ("splat-transform", "gsply", "gaussforge", "spz-js"),
    "-3.spz": ("splat-transform", "gsply", "gaussforge", "@adobe/spz"),
    "-4.spz": ("splat-transform", "gsply", "gaussforge", "@adobe/spz"),
    ".sog": ("splat-transform", "gsply", "gaussforge"),
    ".splat": ("splat-transform", "gaussforge"),
}
OWN_STEPS = {
    ".ply": FLOAT,
    ".compressed.ply": steps_of_compressed,
    "-3.spz": SPZ,
    "-4.spz": SPZ,
    ".sog": steps_of_sog,
    ".splat": SPLAT,
    ".glb": FLOAT,
}
# other values within half a step: rotations as 2 b / 255 - 1, not (b - 128) / 128; colors
OTHER_VALUES = {
    (".splat", "splat-transform"): {"quat": 1 / 255},
    (".compressed.ply", "spz-js"): {"sh": 0.5 * 8 / 256},
}
KEEP_RENDER_MODEL = ("splat-transform", "@adobe/spz")  # gsply, gaussforge and spz-js have none
WITHOUT_RENDER_MODEL = (".splat", ".glb")  # formats that have none


READ = [
    (suffix, name, degree)
    for suffix, names in READERS.items()
    for name in names
    for degree in DEGREES
    if (suffix, name) != (".compressed.ply", "spz-js") or degree in (0, 3)  # it mixes the others up
]


def write_own(folder, suffix, degree):
    path = folder / f"degree{degree}{suffix}"
    if not path.exists():
        registry.write(path, cloud(degree), 4 if suffix == "-4.spz" else 3)
    return path


@pytest.fixture(scope="module")
def read_by_others(tmp_path_factory):
    """The .ply that a program made of a file of ours, by program, suffix and degree."""
    folder = tmp_path_factory.mktemp("readers")
    jobs = {}
    for suffix, name, degree in READ:
        path = write_own(folder, suffix, degree)
        target = folder / f"{path.name}.{name.replace('/', '-')}.ply"
        jobs[name, suffix, degree] = (name, path, target)
    errors = programs.convert_all(list(jobs.values()))
    return {key: (*job[1:], error) for (key, job), error in zip(jobs.items(), errors)}


@pytest.mark.parametrize("degree", DEGREES)
@pytest.mark.parametrize("suffix", OWN_STEPS)
def test_own_files_come_back_to_the_bits_of_the_format(tmp_path, suffix, degree):
    want = cloud(degree)
    got = registry.read(write_own(tmp_path, suffix, degree))
    check_same(got, want, OWN_STEPS[suffix], terms=1 if suffix == ".splat" else 16)
    assert got.is_antialiased is (want.is_antialiased and suffix not in WITHOUT_RENDER_MODEL)


@pytest.mark.parametrize("degree", DEGREES)
def test_own_codebooks_are_no_worse_than_even_steps(tmp_path, degree):
    """256 values that minimize the mean square: that of even steps is step^2 / 12."""
    got = registry.read(write_own(tmp_path, ".sog", degree))
    want = in_order_of(cloud(degree), got.x)
    for a, b in ((np.log(got.scale), np.log(want.scale)), (got.sh[:, :1], want.sh[:, :1]),
                 (got.sh[:, 1:], want.sh[:, 1:])):  # fmt: skip
        if b.size:
            assert np.square(a - b).mean() <= (np.ptp(b) / 255) ** 2 / 12


@needs_tools
@pytest.mark.parametrize("suffix, name, degree", READ)
def test_another_program_reads_the_same(read_by_others, suffix, name, degree):
    """To the precision of float32, in which these programs write what they read."""
    source, target, error = read_by_others[name, suffix, degree]
    assert not error
    got, own = columns_of(target), registry.read(source)
    check_same(got, own, dict.fromkeys(FLOAT, SINGLE) | OTHER_VALUES.get((suffix, name), {}))
    if name in KEEP_RENDER_MODEL:
        marked = cloud(degree).is_antialiased and suffix not in WITHOUT_RENDER_MODEL
        assert got.is_antialiased is own.is_antialiased is marked


# what writes a file of a .ply, the errors that its bits leave, and the number of terms it keeps
WRITERS = {
    ("splat-transform", ".ply"): (FLOAT, 16),
    ("splat-transform", ".compressed.ply"): (steps_of_compressed, 16),
    ("splat-transform", "-3.spz"): (SPZ_5, 16),
    ("splat-transform", "-4.spz"): (SPZ_5, 16),
    ("splat-transform", ".sog"): (lambda c: steps_of_sog(c, 1), 16),
    ("splat-transform", ".glb"): (FLOAT, 16),
    ("gsply", ".ply"): (FLOAT, 16),
    ("gsply", ".compressed.ply"): (steps_of_compressed, 16),
    ("gsply", "-3.spz"): (SPZ_12, 16),
    ("gsply", "-4.spz"): (SPZ_12, 16),
    ("gaussforge", ".ply"): (FLOAT, 16),
    ("gaussforge", "-3.spz"): (SPZ_5, 16),
    ("gaussforge", "-4.spz"): (SPZ_5, 16),
    ("gaussforge", ".sog"): (lambda c: steps_of_sog(c) | {"x": steps_of_sog(c, 1)["x"]}, 16),
    ("gaussforge", ".splat"): (SPLAT | {"opacity": 2 * BYTE, "dc": 2 * BYTE / C0}, 1),
    ("@adobe/spz", "-3.spz"): (SPZ_12, 16),
    ("@adobe/spz", "-4.spz"): (SPZ_12, 16),
    ("spz-js", ".ply"): (FLOAT, 16),
    ("spz-js", ".compressed.ply"): (steps_of_compressed, 16),
    ("@mkkellogg/gaussian-splats-3d", "-0.ksplat"): (KSPLAT, 9),
    ("@mkkellogg/gaussian-splats-3d", "-1.ksplat"): (KSPLAT_1, 9),
    ("@mkkellogg/gaussian-splats-3d", "-2.ksplat"): (KSPLAT_2, 9),
}


@pytest.fixture(scope="module")
def written_by_others(tmp_path_factory):
    """The file that a program made of a .ply of degree 3, by program and suffix."""
    folder = tmp_path_factory.mktemp("writers")
    source = write_own(folder, ".ply", 3)
    made = [*WRITERS, ("spz-js", ".spz"), ("gaussforge", ".compressed.ply"),
            ("gaussforge", ".ksplat")]  # fmt: skip
    jobs = [(name, source, folder / f"{name.replace('/', '-')}{suffix}") for name, suffix in made]
    errors = programs.convert_all(jobs)
    assert errors == [""] * len(jobs)
    return {key: job[2] for key, job in zip(made, jobs)}


@needs_tools
@pytest.mark.parametrize("name, suffix", WRITERS)
def test_what_another_program_wrote_is_the_ply(written_by_others, name, suffix):
    steps, terms = WRITERS[name, suffix]
    got = registry.read(written_by_others[name, suffix])
    check_same(got, cloud(3), steps, terms)
    kept = name in KEEP_RENDER_MODEL and suffix != ".glb"
    assert got.is_antialiased is kept
    frame = ("LUF", "the axes of glTF, turned to RDF") if suffix == ".glb" else ("", "")
    if suffix.endswith(".spz"):
        frame = ("", "taken as in a .ply, the file does not say")
    assert (got.record.frame, got.record.frame_source) == frame


@needs_tools
def test_a_spz_of_version_2_is_the_ply(written_by_others):
    """Its rotations are x, y and z in bytes: w, the root of the rest, may be off by far more."""
    got = registry.read(written_by_others["spz-js", ".spz"])
    want = in_order_of(cloud(3), got.x)
    quat = want.quat * np.where(want.quat[:, :1] < 0, -1, 1)
    check_bound("quat", got.quat[:, 1:] - quat[:, 1:], 0.5 / 127.5 + 1e-3)  # of another norm
    check_same(got, want, SPZ_5 | {"quat": 1})


@needs_tools
@pytest.mark.parametrize("name, suffix", [
    ("splat-transform", ".sog"), ("gaussforge", ".sog"), ("gaussforge", ".compressed.ply")
])  # fmt: skip
def test_colors_by_palette_and_in_another_order_are_read_as_by_another_program(
    written_by_others, tmp_path, name, suffix
):
    """splat-transform's palette of colors is coarse, and gaussforge writes the colors of a
    .compressed.ply in an order that no program reads: these are compared as they are read."""
    source, target = written_by_others[name, suffix], tmp_path / "a.ply"
    assert programs.convert_all([("gsply", source, target)]) == [""]
    got = registry.read(source)
    check_same(columns_of(target), got, dict.fromkeys(FLOAT, SINGLE))
    assert ["wrong order" in text for text in got.record.doubts] == [True] * (suffix != ".sog")


@needs_tools
def test_a_ksplat_of_degree_3_is_refused(written_by_others):
    """GaussianSplats3D neither reads nor writes it; gaussforge has an order of its own."""
    with pytest.raises(registry.GaussianFileError, match="colors of degree 3: allowed are 0 to 2"):
        registry.read(written_by_others["gaussforge", ".ksplat"])


@needs_tools
@pytest.mark.parametrize("degree", DEGREES)
def test_three_js_reads_a_glb_as_the_ply_turned_to_its_axes(tmp_path, degree):
    """x left, y up, z forward. Its colors are bytes: 128 + 128 c above degree 0."""
    source, target = write_own(tmp_path, ".glb", degree), tmp_path / "a.json"
    assert programs.convert_all([("three", source, target)]) == [""]
    found, want = json.loads(target.read_text()), cloud(degree)
    turn = np.array([-1, -1, 1])
    x = np.reshape(found["position"], (COUNT, 3))
    np.testing.assert_allclose(x, turn * want.x, rtol=1e-6)
    largest = want.scale.max(axis=1)[:, None, None] ** 2
    got = unpack_symmetric(np.reshape(found["covariance"], (COUNT, 6)))
    turned = turn[:, None] * unpack_symmetric(want.cov()) * turn
    np.testing.assert_allclose(got / largest, turned / largest, atol=2e-6)
    rgba = np.reshape(found["color"], (COUNT, 4)) / 255
    np.testing.assert_allclose(rgba, np.column_stack([want.rgb, want.opacity]), atol=BYTE + 1e-6)
    first = 1
    for k in range(1, 4):
        assert (f"sphericalHarmonics{k}" in found) is (k <= degree)
        if k <= degree:
            last = first + 2 * k + 1
            codes = np.reshape(found[f"sphericalHarmonics{k}"], (COUNT, -1))
            codes = codes[:, : 3 * (last - first)].reshape(COUNT, -1, 3)
            signs = np.array(HALF_TURN_ABOUT_Z[first - 1 : last - 1])[:, None]
            np.testing.assert_allclose(
                (codes - 128) / 128, signs * want.sh[:, first:last], atol=0.5 / 128 + 1e-6
            )
            first = last


@needs_tools
def test_khronos_validator_finds_no_fault_outside_of_the_extension(tmp_path):
    """It does not know the extension, and names its attributes as unknown."""
    source, target = write_own(tmp_path, ".glb", 3), tmp_path / "a.json"
    assert programs.convert_all([("gltf-validator", source, target)]) == [""]
    report = json.loads(target.read_text())
    messages = report["issues"]["messages"]
    assert [
        m for m in messages if "KHR_gaussian_splatting" not in m["message"] + m["pointer"]
    ] == []
    assert report["info"]["totalVertexCount"] == COUNT


@needs_tools
@pytest.mark.parametrize("degree", DEGREES)
def test_a_stage_of_openusd_has_the_numbers_that_nvidias_converter_writes(tmp_path, degree):
    """No second program reads these stages; this one writes them of a .ply."""
    pytest.importorskip("pxr", reason="needs usd-core: pip install 'vgmpi[usd]'")
    from pxr import Usd, UsdVol  # noqa: F401

    want = cloud(degree)
    root = rotation_matrices(want.quat)
    root = pack_symmetric((root * want.scale[:, None, :]) @ root.transpose(0, 2, 1))
    rest = layout.RestGaussians(want.x, root, want.opacity, want.sh)
    group = layout.MotionGroup("capture", COUNT, layout.STATIC, layout.FIXED)
    stage = UsdStage(tmp_path / "own.usda", [group], rest, frames=1, rate=10)
    stage.add_frame([], [], {})
    stage.save()
    source = write_own(tmp_path, ".ply", degree)
    assert programs.convert_all([("gsplat2usd", source, tmp_path / "a.usda")]) == [""]
    values = []
    for path in (tmp_path / "own.usda", tmp_path / "a.usda"):
        opened = Usd.Stage.Open(str(path))
        (prim,) = [
            p for p in opened.Traverse() if p.GetTypeName() == "ParticleField3DGaussianSplat"
        ]
        values.append({a.GetName(): a.Get() for a in prim.GetAttributes() if a.HasValue()})
    own, other = values
    for name in ("positions", "opacities", "radiance:sphericalHarmonicsCoefficients"):
        np.testing.assert_allclose(np.array(own[name]), np.array(other[name]), rtol=2e-6, atol=2e-6)
    assert own["radiance:sphericalHarmonicsDegree"] == degree
    assert other["radiance:sphericalHarmonicsDegree"] == degree
    shapes = [_covariances_of_stage(v) for v in values]
    largest = want.scale.max(axis=1)[:, None, None] ** 2
    np.testing.assert_allclose(shapes[0] / largest, shapes[1] / largest, atol=2e-6)
    np.testing.assert_allclose(shapes[0] / largest, covariances(want) / largest, atol=2e-6)


def _covariances_of_stage(values):
    quat = np.array([[q.GetReal(), *q.GetImaginary()] for q in values["orientations"]])
    quat /= np.linalg.norm(quat, axis=1)[:, None]
    return covariances(SimpleNamespace(quat=quat, scale=np.array(values["scales"], np.float64)))
