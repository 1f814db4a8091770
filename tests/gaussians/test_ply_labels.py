"""Columns of integers of Gaussian .ply files: kept, written back, selected by scenes, inspected."""

import numpy as np
import pytest

from tests.support.gaussian_files import columns, table
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.formats import registry
from vgmpi.preprocess.capture_selection import crop
from vgmpi.preprocess.inspect_file import describe_file
from vgmpi.preprocess.placement import PlacementError
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.captures import Select
from vgmpi.scene.loader import load


@pytest.fixture
def read(tmp_path):
    """Function that reads the bytes of a .ply file."""

    def from_bytes(data):
        path = tmp_path / "cloud.ply"
        path.write_bytes(data)
        return registry.read(path)

    return from_bytes


@pytest.mark.parametrize("form", ["<", ">", "ascii"])
def test_all_columns_of_integers_are_kept(read, form):
    cloud = read(
        table(
            columns(
                label=("uchar", [3, 255, 0]),
                object_id=("int", [-1, 2**31 - 1, 5]),
                packed=("uint", [2**32 - 1, 0, 1]),
                nx=("int", [1, 2, 3]),
                alpha=("uchar", [1, 2, 3]),
                segment=("float", [1.0, 2.0, -3.0]),
                confidence=("float", [1.0, 2.0, 3.0]),
            ),
            form,
        )
    )
    assert {name: label.tolist() for name, label in cloud.labels.items()} == {
        "label": [3, 255, 0],
        "object_id": [-1, 2**31 - 1, 5],
        "packed": [2**32 - 1, 0, 1],
        "segment": [1, 2, -3],
    }
    assert all(label.dtype in (np.int32, np.int64) for label in cloud.labels.values())


def test_a_label_with_fractions_is_left_out(read):
    cloud = read(table(columns(label=("float", [1.0, 2.5, 3.0]))))
    assert not cloud.labels
    assert cloud.record.omissions == ("the column 'label' holds no integers and is left out",)


def test_rows_that_are_dropped_take_their_labels_along(read):
    n = 20_000  # more than a block
    x = np.zeros(n)
    x[[5, 17_000]] = np.nan
    label = np.arange(n)
    cloud = read(table(columns(n=n, x=("float", x.tolist()), label=("int", label.tolist()))))
    np.testing.assert_array_equal(cloud.labels["label"], np.delete(label, [5, 17_000]))


def labeled(n=6, **labels):
    cloud = GaussianCloud(
        np.arange(3 * n).reshape(n, 3), np.tile([1.0, 0, 0, 0], (n, 1)), np.full((n, 3), 0.1),
        np.full(n, 0.9), np.zeros((n, 4, 3)), labels=labels,
    )  # fmt: skip
    return cloud


def test_labels_are_written_back(tmp_path):
    labels = {
        "label": np.array([1, 2, 3, 1, 2, -3], dtype=np.int32),
        "object_id": np.array([1, 2, 3, 4, 5, 2**32 - 1]),
        "id": np.array([0, 1, 2, 3, 4, 2**52 + 1]),
    }
    registry.write(tmp_path / "c.ply", labeled(**labels))
    again = registry.read(tmp_path / "c.ply")
    assert list(again.labels) == list(labels)
    for name, label in labels.items():
        np.testing.assert_array_equal(again.labels[name], label)
    head = (tmp_path / "c.ply").read_bytes().split(b"end_header")[0]
    for line in (b"property int label", b"property uint object_id", b"property double id"):
        assert line in head
    registry.write(tmp_path / "plain.ply", labeled())
    plain = registry.read(tmp_path / "plain.ply")
    for name in ("x", "quat", "scale", "opacity", "sh"):
        np.testing.assert_array_equal(getattr(again, name), getattr(plain, name))


def test_a_selection_keeps_the_gaussians_of_some_labels():
    cloud = labeled(label=np.array([3, 1, 5, 3, 2, 9]))
    part = crop(cloud, Select(property="label", values=[3, 5]))
    np.testing.assert_array_equal(part.x, cloud.x[[0, 2, 3]])
    assert not part.labels
    both = Select(property="label", values=3, box=((-1, -1, -1), (5, 5, 5)))
    np.testing.assert_array_equal(crop(cloud, both).x, cloud.x[[0]])
    assert not crop(cloud, None).labels  # a run has no use for them


@pytest.mark.parametrize(
    "name, message",
    [
        ("lable", r"'lable' is no column .*did you mean 'label'\?\); known: label, id"),
        ("label", r"one of the values 4, 7 of 'label', which has 4: 1, 2, 3, 9$"),
    ],
)
def test_a_selection_of_nothing_is_one_line(name, message):
    cloud = labeled(label=np.array([3, 1, 3, 3, 2, 9]), id=np.arange(6))
    with pytest.raises(PlacementError, match=message) as caught:
        crop(cloud, Select(property=name, values=[4, 7]))
    assert caught.value.key == "select" and "\n" not in str(caught.value)


def test_a_file_without_labels_is_told():
    with pytest.raises(PlacementError, match="known: none"):
        crop(labeled(), Select(property="label", values=[1]))


SCENE = """
[domain]
size = ["48 cm", "48 cm", "48 cm"]
cell = "2 cm"
[time]
end = "0.1 s"
frames = 2
[material]
rubber = {{ kind = "elastic", density = 400, youngs_modulus = "0.1 MPa" }}
[[object]]
name = "body"
material = "rubber"
gaussians = "c.ply"
position = ["24 cm", "24 cm", "10 cm"]
select = {{ {} }}
"""


@pytest.mark.parametrize(
    "keys, message",
    [
        ('property = "label"', "needs values"),
        ("values = [3]", "needs property"),
        ('property = "label", values = [1.5]', r"integer or a list of integers, such as \[3, 5\]"),
        ('property = "label", values = []', "integer or a list of integers"),
        ('property = "label", values = [true]', "integer or a list of integers"),
        ('property = "label", values = 99999999999999999999', "must fit in 64 bits"),
        ('propperty = "label", values = [1]', "did you mean 'property'"),
    ],
)
def test_a_scene_with_a_bad_selection(tmp_path, keys, message):
    registry.write(tmp_path / "c.ply", labeled(label=np.arange(6)))
    (tmp_path / "scene.toml").write_text(SCENE.format(keys))
    with pytest.raises(SceneError, match=rf"scene\.toml:1\d: .*{message}"):
        load(tmp_path / "scene.toml")


def test_a_scene_with_a_selection(tmp_path):
    registry.write(tmp_path / "c.ply", labeled(label=np.arange(6)))
    (tmp_path / "scene.toml").write_text(SCENE.format('property = "label", values = [3, 5]'))
    select = load(tmp_path / "scene.toml").object[0].select
    assert (select.property, select.values) == ("label", (3, 5))


def test_labels_are_inspected(tmp_path):
    label = np.repeat([7, -2, 5], [100, 300, 200])
    many = np.arange(600) % 20
    registry.write(tmp_path / "c.ply", labeled(600, label=label, part=many, id=np.arange(600)))
    lines = describe_file(tmp_path / "c.ply").splitlines()
    assert "  labels   label: -2 (300), 5 (200), 7 (100)" in lines
    first = ", ".join(f"{value} (30)" for value in range(8))
    assert f"  labels   part: {first}, ... of 20 values" in lines
    assert "  labels   id: 0 to 599, all different" in lines
    registry.write(tmp_path / "d.ply", labeled())
    assert "labels  " not in describe_file(tmp_path / "d.ply")
