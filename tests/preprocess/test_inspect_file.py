"""--inspect tells what a file of Gaussians holds, whatever its format, and names what it cannot."""

import pytest

from tests.gaussians.test_sog import cloud
from tests.support import hostile_containers as bad
from tests.support import splat_containers as made
from vgmpi.gaussians.formats import registry
from vgmpi.preprocess import inspect_file


@pytest.mark.parametrize("suffix", registry.WRITTEN)
def test_gaussians_are_counted(tmp_path, suffix):
    if suffix == registry.COMPRESSED:
        pytest.importorskip("gsply", reason="needs gsply: pip install 'vgmpi[test]'")
    path = tmp_path / f"a{suffix}"
    registry.write(path, cloud(n=300))
    assert inspect_file.is_inspectable(path)
    assert inspect_file.describe_file(path).startswith(f"{path}: 300 Gaussians")


def test_a_ksplat_is_counted(tmp_path):
    path = tmp_path / "a.KSPLAT"
    path.write_bytes(bad.KSPLAT_GOOD)
    assert "5 Gaussians, colors of degree 1" in inspect_file.describe_file(path)


@pytest.mark.parametrize("name", ["a.lcc", "a.rad", "a.4dgs"])
def test_a_format_that_is_not_read_is_named(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(b"anything")
    assert inspect_file.is_inspectable(path)
    with pytest.raises(registry.GaussianFileError, match="not read: convert it to .ply"):
        inspect_file.describe_file(path)


def test_a_glb_of_a_mesh_is_told_to_be_one(tmp_path):
    header, binary = made.gltf_parts(made.gltf_columns())
    del header["meshes"][0]["primitives"][0]["extensions"]
    path = tmp_path / "a.glb"
    path.write_bytes(made.glb(header, binary))
    with pytest.raises(registry.GaussianFileError, match="a mesh. Convert it to .obj"):
        inspect_file.describe_file(path)
