"""Gaussian .ply files as trainers and editors write them, value by value from their layouts."""

import struct

import numpy as np
import pytest

from tests.support import gaussian_files
from tests.support.gaussian_files import columns, table
from vgmpi.gaussians.cloud import CaptureRecord, GaussianCloud
from vgmpi.gaussians.formats import registry
from vgmpi.gaussians.formats.ply import apply_filter
from vgmpi.gaussians.formats.validation import read_validated
from vgmpi.gaussians.spherical_harmonics import C0
from vgmpi.preprocess.inspect_file import describe_file


@pytest.fixture
def read(tmp_path):
    """Function that reads the bytes of a .ply file."""

    def from_bytes(data):
        path = tmp_path / "cloud.ply"
        path.write_bytes(data)
        return registry.read(path)

    return from_bytes


def same(a, b):
    for name in ("x", "quat", "scale", "opacity", "sh"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


@pytest.mark.parametrize("rest", [0, 9, 24, 45])
def test_text_is_what_its_numbers_are_in_bytes(read, rest):
    some = columns(rest=rest, nx=("float", [0.1, 1e-30, -3.5e7]))
    binary, text = read(table(some)), read(table(some, "ascii"))
    same(binary, text)
    assert text.sh.shape == (3, rest // 3 + 1, 3)
    assert (binary.record.encoding, text.record.encoding) == (
        ".ply, binary little-endian", ".ply, ASCII text")  # fmt: skip


def test_text_in_the_style_of_other_writers(read):
    """Exponents, signs, tabs, line ends of Windows, blank lines, no end of the last line."""
    plain = read(table(columns(n=2), "ascii"))
    text = table(columns(n=2), "ascii").decode()
    head, data = text.split("end_header\n")
    styled = data.replace("-3.0 ", " -3.00e+00\t").replace("\n", "\r\n\r\n").rstrip()
    same(plain, read((head.replace("\n", "\r\n") + "end_header\r\n" + styled).encode()))


def test_many_rows_of_text(read):
    """More than a block, so that blocks follow one another."""
    n = 40_000
    rng = np.random.default_rng(3)
    x = rng.normal(size=n).astype(np.float32)
    cloud = read(table(columns(n=n, x=("float", x.tolist())), "ascii"))
    np.testing.assert_array_equal(cloud.x[:, 0], x)


@pytest.mark.parametrize("form", ["<", ">", "ascii"])
def test_elements_behind_the_gaussians(read, form):
    """Their contents are not looked at, whether lists, numbers or nothing."""
    alone = read(table(columns(), form))
    for lines, data in (
        (["element face 0", "property list uchar int vertex_indices"], b""),
        (["element face 2", "property list uchar int vertex_indices"], b"\3 1 2 3\n garbage"),
        (["element camera 1"], b""),
    ):
        same(alone, read(table(columns(), form, behind=(lines, data))))


@pytest.mark.parametrize("form", ["<", ">", "ascii"])
def test_elements_before_the_gaussians(read, form):
    alone = read(table(columns(), form))
    lists = struct.pack(f"{form}B3iB1i", 3, 7, 8, 9, 1, 5) if form != "ascii" else b"3 7 8 9\n1 5\n"
    face = ["element face 2", "property list uchar int vertex_indices"]
    mixed = struct.pack(f"{form}fH2dB", 1.5, 2, 1, 2, 4) if form != "ascii" else b"1.5 2 1 2 4\n"
    box = ["element box 1", "property float a", "property list ushort double b"]
    box += ["property uchar c"]
    for lines, data in (
        (["element camera 1"], b""),
        (face, lists),
        (box, mixed),
        ([*face, *box, "element empty 9"], lists + mixed),
    ):
        same(alone, read(table(columns(), form, before=(lines, data))))


@pytest.mark.parametrize("form", ["<", ">", "ascii"])
def test_every_type_of_number(read, form):
    """Positions and rotations of integers and of other precisions are numbers all the same."""
    typed = columns(
        x=("double", [512345.253, 1 / 3, 1e-9]),
        y=("short", [-300, 2, 3]),
        z=("half", [0.5, -2.0, 1024.0]),
        rot_0=("char", [-1, 0, 127]),
        rot_1=("uint", [0, 4_000_000_000, 0]),
    )
    cloud = read(table(typed, form))
    np.testing.assert_array_equal(cloud.x[:, 0], typed["x"][1])
    np.testing.assert_array_equal(cloud.x[:, 1:], np.transpose([typed["y"][1], typed["z"][1]]))
    np.testing.assert_array_equal(cloud.quat, [[-1, 0, 0, 0], [0, 1, 0, 0], [1, 0, 0, 0]])


@pytest.mark.parametrize("form", ["<", "ascii"])
def test_two_scales_are_a_flat_disc(read, form):
    """2DGS: the third axis of the rotation is the normal, and the thickness is next to nothing."""
    half = float(np.sqrt(0.5))
    rot = {f"rot_{k}": ("float", [v] * 3) for k, v in enumerate((half, half, 0.0, 0.0))}
    some = columns(scales=2, **rot, scale_0=("float", [-2.0, 1.0, 0.0]))
    cloud = read(table(some, form))
    want = np.exp([[-2.0, -4.0], [1.0, -4.0], [0.0, -4.0]])
    np.testing.assert_allclose(cloud.scale[:, :2], want, rtol=1e-6)
    np.testing.assert_allclose(cloud.scale[:, 2], 1e-3 * want.min(axis=1), rtol=1e-6)
    assert "2D Gaussians" in cloud.record.encoding
    # a quarter turn about x: the normal z points to -y, so that the disc has no extent along y
    cov = cloud.cov()[1]
    np.testing.assert_allclose(cov[[0, 5]], [want[1, 0] ** 2, want[1, 1] ** 2], rtol=1e-5)
    assert cov[3] < 2e-6 * want[1, 1] ** 2
    assert (
        np.linalg.eigvalsh(cloud.cov()[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3, 3)) > 0
    ).all()


def rgb(kind, red, green, blue):
    colors = {"red": (kind, red), "green": (kind, green), "blue": (kind, blue)}
    return columns(f_dc_0=None, f_dc_1=None, f_dc_2=None, **colors)


@pytest.mark.parametrize("form", ["<", "ascii"])
def test_colors_as_red_green_blue(read, form):
    """As ns-export gaussian-splat --ply-color-mode rgb writes them: bytes of 255 f_dc C0 + 0.5."""
    cloud = read(table(rgb("uchar", [0, 255, 51], [255, 0, 102], [128, 64, 153]), form))
    want = np.array([[0, 255, 128], [255, 0, 64], [51, 102, 153]]) / 255
    np.testing.assert_allclose(C0 * cloud.sh[:, 0] + 0.5, want, atol=1e-7)
    assert cloud.sh.shape == (3, 1, 3) and not cloud.labels
    wide = read(table(rgb("ushort", [0, 65535, 13107], [0, 0, 0], [0, 0, 0]), form))
    np.testing.assert_allclose(wide.rgb[:, 0], [0, 1, 0.2], atol=1e-7)
    real = read(table(rgb("float", [0.0, 1.0, 0.25], [0.0] * 3, [0.0] * 3), form))
    np.testing.assert_allclose(real.rgb[:, 0], [0, 1, 0.25], atol=1e-7)
    assert not real.record.doubts


def test_constant_coefficients_win_over_colors(read):
    red = {name: ("uchar", [9, 9, 9]) for name in ("red", "green", "blue", "alpha")}
    cloud = read(table(columns(**red)))
    np.testing.assert_allclose(cloud.sh[0, 0], [0, 0.1, 0.2], atol=1e-7)
    assert not cloud.labels


def test_colors_above_degree_3_are_left_out(read):
    """Coefficient k of channel c of degree 4 is f_rest_{24 c + k}; 15 of 24 remain."""
    cloud = read(table(columns(rest=72)))
    want = np.arange(15)[:, None] + 24 * np.arange(3)
    np.testing.assert_array_equal(cloud.sh[0, 1:], want)
    assert cloud.record.omissions == ("colors of degree 4 are left out, the highest is 3",)


def compressed(n=300, rest=None, head=lambda text: text):
    rng = np.random.default_rng(2)
    data = gaussian_files.compressed(
        rng.normal(size=(n, 3)), rng.normal(size=(n, 4)), rng.normal(size=(n, 3)),
        rng.random((n, 3)), rng.random(n), rest,
    )  # fmt: skip
    text, end, rows = data.partition(b"end_header\n")
    return head(text) + end + rows


def test_a_compressed_file_of_degree_0_with_an_empty_element(read):
    """gsplat's exporter names the element sh without properties."""
    alone = read(compressed())
    same(alone, read(compressed(head=lambda text: text + b"element sh 300\n")))
    assert alone.record.encoding == ".ply, SuperSplat's compressed layout"


def test_a_compressed_file_of_degree_4(read):
    rest = np.random.default_rng(0).integers(0, 256, (300, 72))
    cloud = read(compressed(rest=rest))
    want = (rest.reshape(300, 3, 24).transpose(0, 2, 1)[:, :15] / 255 - 0.5) * 8
    assert np.abs(cloud.sh[:, 1:] - want).max() <= 8 / 255
    assert "colors of degree 4 are left out" in cloud.record.omissions[0]


@pytest.mark.parametrize(
    "comments, is_antialiased, source",
    [
        ((), False, ""),
        (("SplatRenderMode: mip",), True, "SplatRenderMode: mip"),
        (("splatrendermode:MIP ",), True, "splatrendermode:MIP"),
        (("SplatRenderMode: default",), False, "SplatRenderMode: default"),
        (("antialiased 1",), True, "antialiased 1"),
        (("antialiased 0",), False, "antialiased 0"),
        (("antialiased 1", "SplatRenderMode: default"), False, "SplatRenderMode: default"),
        (("Exported from Brush", "not antialiased 1"), False, ""),
    ],
)
@pytest.mark.parametrize("kind", ["<", "ascii", "compressed"])
def test_the_render_model_is_a_comment(read, comments, is_antialiased, source, kind):
    """The comments of Brush and Postshot, as splat-transform reads them: the last one counts."""
    if kind == "compressed":
        lines = "".join(f"comment {text}\n" for text in comments).encode()
        data = compressed(head=lambda text: text + lines)
    else:
        data = table(columns(), kind, comments)
    cloud = read(data)
    assert cloud.is_antialiased is is_antialiased
    told = f"the file has the comment '{source}'" if source else ""
    assert cloud.record.render_model_source == told
    assert not any("antialiased 1" == text or "Mode" in text for text in cloud.record.comments)


def test_two_scales_are_not_antialiased(read):
    assert not read(table(columns(scales=2), comments=["antialiased 1"])).is_antialiased


@pytest.mark.parametrize("suffix", [".ply", ".compressed.ply"])
def test_the_render_model_is_written(tmp_path, suffix):
    if suffix != ".ply":
        pytest.importorskip("gsply")
    n = 5
    quat = np.tile([1.0, 0, 0, 0], (n, 1))
    for is_antialiased in (False, True):
        cloud = GaussianCloud(
            np.eye(n, 3), quat, np.full((n, 3), 0.1), np.full(n, 0.5), np.zeros((n, 1, 3)),
            is_antialiased=is_antialiased,
        )  # fmt: skip
        path = tmp_path / f"cloud{suffix}"
        registry.write(path, cloud)
        head = path.read_bytes().split(b"end_header")[0]
        assert (b"\ncomment SplatRenderMode: mip\n" in head) is is_antialiased
        assert registry.read(path).is_antialiased is is_antialiased


def test_the_filter_of_mip_splatting_by_hand():
    """Scales 3, 4, 12 and a filter of 4: 5, 4 sqrt(2), 4 sqrt(10); the ratio of the volumes is
    144 / (5 * 4 sqrt(2) * 4 sqrt(10)) = 9 / (5 sqrt(20))."""
    scale, opacity = apply_filter(np.array([[3.0, 4.0, 12.0]]), np.array([0.5]), np.array([[4.0]]))
    np.testing.assert_allclose(scale, [[5, 4 * np.sqrt(2), 4 * np.sqrt(10)]], rtol=1e-15)
    np.testing.assert_allclose(opacity, [0.5 * 9 / (5 * np.sqrt(20))], rtol=1e-15)
    flat, faint = apply_filter(np.array([[0.0, 0.0]]), np.array([1.0]), np.array([[0.0]]))
    assert (flat == 0).all() and faint[0] == 1  # nothing is smoothed by nothing


@pytest.mark.parametrize("form", ["<", "ascii"])
def test_the_column_of_the_filter_is_applied(read, form):
    logs = {f"scale_{k}": ("double", [float(np.log(s))] * 3) for k, s in enumerate((3, 4, 12))}
    some = columns(**logs, opacity=("double", [0.0] * 3), filter_3D=("float", [4.0, 0.0, 3.0]))
    cloud = read(table(some, form))
    np.testing.assert_allclose(cloud.scale[0], [5, 4 * np.sqrt(2), 4 * np.sqrt(10)], rtol=1e-12)
    np.testing.assert_allclose(cloud.scale[1], [3, 4, 12], rtol=1e-12)
    np.testing.assert_allclose(cloud.opacity[:2], [0.5 * 9 / (5 * np.sqrt(20)), 0.5], rtol=1e-12)
    assert cloud.record.has_filter_3d and not cloud.labels
    assert not read(table(columns(), form)).record.has_filter_3d


def test_comments_are_told_printable_and_short(read):
    many = ["Generated by a trainer", "Vertical Axis: y\x07", "", "é" * 500, *map(str, range(50))]
    told = read(table(columns(), comments=many)).record.comments
    assert told[:2] == ("Generated by a trainer", "Vertical Axis: y?")
    assert len(told) == 8 and len(told[2]) == 120 and all(text.isprintable() for text in told)


def test_rows_that_are_dropped_are_recorded(read):
    x = [0.0] * 499 + [np.nan]
    cloud = read(table(columns(n=500, x=("float", x))))
    assert len(cloud) == 499
    assert cloud.record.omissions == (
        "1 of 500 Gaussians are not finite (or above 1e18), have no size or no rotation: left out",
    )


def test_a_cloud_of_points_and_a_mesh_are_told(read):
    points = {name: column for name, column in columns().items() if name in "xyz"}
    with pytest.raises(registry.GaussianFileError, match="is a cloud of points: .*'mesh'"):
        read(table(points))
    face = ["element face 1", "property list uchar int vertex_indices"]
    with pytest.raises(registry.GaussianFileError, match="is a mesh"):
        read(table(points, behind=(face, b"\3" + bytes(12))))


def test_lists_among_the_gaussians_are_told(read):
    data = table(columns()).replace(b"property float rot_3", b"property list uchar float rot_3")
    with pytest.raises(registry.GaussianFileError, match="lists in element 'vertex'"):
        read(data)


@pytest.mark.parametrize("form", ["<", "ascii"])
def test_a_mesh_is_inspected_as_one(tmp_path, form):
    """A .ply may be either; the reader of Gaussians has the first look at it."""
    points = {"x": ("float", [0.0, 1.0, 0.0]), "y": ("float", [0.0, 0.0, 1.0])}
    points["z"] = ("float", [0.0, 0.0, 0.0])
    face = ["element face 1", "property list uchar int vertex_indices"]
    data = struct.pack("<B3i", 3, 0, 1, 2) if form == "<" else b"3 0 1 2\n"
    path = tmp_path / "mesh.ply"
    path.write_bytes(table(points, form, behind=(face, data)))
    assert "a mesh of 1 triangles" in describe_file(path)


def test_values_that_are_clamped_are_counted():
    """Opacities outside of 0..1, which no column of logits can hold."""
    n = 20_000  # more than a block
    opacity = np.full(n, 0.5)
    opacity[[3, 17_000, 19_000]] = 1.5, -0.25, 1.0
    quat, scale = np.tile([1.0, 0, 0, 0], (n, 1)), np.ones((n, 3))

    def decoded(a, b):
        return scale[a:b], quat[a:b], scale[a:b], opacity[a:b], np.zeros((b - a, 1, 3))

    cloud = read_validated(n, decoded, CaptureRecord(encoding="by hand", omissions=("a thing",)))
    assert cloud.record.omissions == (
        "a thing",
        "opacities outside of 0..1 of 2 Gaussians are clamped",
    )
    np.testing.assert_array_equal(cloud.opacity[[3, 17_000, 19_000]], [1, 0, 1])
    assert read_validated(n, decoded).record is None
