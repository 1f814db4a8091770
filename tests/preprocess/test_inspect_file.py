"""--inspect tells what a file of Gaussians holds, whatever its format, and names what it cannot."""

import numpy as np
import pytest

from tests.gaussians.test_sog import cloud
from tests.support import hostile_containers as bad
from tests.support import splat_containers
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


@pytest.mark.parametrize("suffix", registry.WRITTEN)
def test_axes_and_training_are_told_of_every_format(tmp_path, suffix):
    """Also where the file does not say, and what is assumed then."""
    if suffix == registry.COMPRESSED:
        pytest.importorskip("gsply", reason="needs gsply: pip install 'vgmpi[test]'")
    path = tmp_path / f"a{suffix}"
    registry.write(path, cloud(n=300, is_antialiased=True))
    lines = inspect_file.describe_file(path).splitlines()
    assert max(map(len, lines)) < 100 + len(str(path))
    axes = {
        registry.SPZ: "RDF: said by the file's record",
        registry.GLTF: "LUF: the axes of glTF, turned to RDF",
    }
    unknown = "RDF (x right, y down, z forward) is assumed: the file does not say"
    assert lines[2] == f"  axes     {axes.get(suffix, unknown)}"
    unmarked = suffix in (".splat", registry.GLTF)
    said = "not antialiased is assumed: the file does not say" if unmarked else "antialiased: "
    assert lines[3].startswith(f"  training {said}")
    (extent,) = (line for line in lines if line.startswith("  extent   x "))
    assert extent.endswith(", in the units of the file")
    (sizes,) = (line for line in lines if line.startswith("  sizes    longest axis "))
    c = registry.read(path)
    assert f"longest axis {np.median(c.scale.max(axis=1)):.3g}, shortest" in sizes


def test_doubts_are_told_apart_from_notes(tmp_path):
    meta, members, _ = splat_containers.sog_members()
    path = tmp_path / "a.sog"
    path.write_bytes(splat_containers.sog(meta | {"model": "2dgs"}, members))
    text = inspect_file.describe_file(path)
    assert "\n  doubt    " in text and "\n  note     " not in text


def test_view_dependent_colors_that_are_all_zero_are_told(tmp_path):
    """gsplat.js writes such files."""
    shiny = cloud(n=3)
    registry.write(tmp_path / "a.ply", shiny)
    assert "are zero" not in inspect_file.describe_file(tmp_path / "a.ply")
    shiny.sh[:, 1:] = 0
    registry.write(tmp_path / "a.ply", shiny)
    lines = inspect_file.describe_file(tmp_path / "a.ply").splitlines()
    assert "  note     all colors above degree 0 are zero" in lines
    registry.write(tmp_path / "b.ply", cloud(n=3, terms=1))
    assert "are zero" not in inspect_file.describe_file(tmp_path / "b.ply")


@pytest.mark.parametrize("name", ["meta.json", "lod-meta.json"])
def test_an_unbundled_sog_is_named(tmp_path, name):
    (tmp_path / name).write_text("{}")
    assert inspect_file.is_inspectable(tmp_path / name)
    with pytest.raises(registry.GaussianFileError, match=r"an unbundled SOG .*convert it to \.ply"):
        inspect_file.describe_file(tmp_path / name)
    assert not inspect_file.is_inspectable(tmp_path / "checkpoint_000000200.json")


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
    header, binary = splat_containers.gltf_parts(splat_containers.gltf_columns())
    del header["meshes"][0]["primitives"][0]["extensions"]
    path = tmp_path / "a.glb"
    path.write_bytes(splat_containers.glb(header, binary))
    with pytest.raises(registry.GaussianFileError, match="a mesh. Convert it to .obj"):
        inspect_file.describe_file(path)
