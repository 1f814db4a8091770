"""Mesh files as other programs write them: points, triangles and colors are those of the file."""

import struct

import meshio.gmsh
import numpy as np
import pytest
import pyvista
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

from vgmpi.preprocess import inspect_file
from vgmpi.preprocess.meshes import surface_mesh
from vgmpi.preprocess.meshes.surface_mesh import MeshError

# a quad and a triangle of five points, whose colors lie on both sides of 128
POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 2, 0.25]])
RGB = np.array([[0, 127, 128], [255, 1, 200], [129, 254, 3], [64, 192, 32], [250, 250, 250]])
FACES = [[0, 1, 2, 3], [3, 2, 4]]
TRIANGLES = [[0, 1, 2], [0, 2, 3], [3, 2, 4]]
NUMBER = {"uchar": "B", "int": "i", "float": "f", "double": "d", "ushort": "H"}


def ply(path, form, kind="uchar", per="vertex", scale=1.0, alpha=False, point="float"):
    """Write the mesh as .ply, entry by entry."""
    names = ["red", "green", "blue", *(["alpha"] if alpha else [])]
    colors = [f"property {kind} {name}" for name in names]
    own = {"vertex": [f"property {point} {axis}" for axis in "xyz"],
           "face": ["property list uchar int vertex_indices"]}  # fmt: skip
    own[per] = own[per] + colors
    head = ["ply", f"format {form} 1.0", "comment by a test", "element vertex 5", *own["vertex"]]
    head += ["element face 2", *own["face"], "end_header", ""]
    wide = np.column_stack([RGB, np.full(5, 77)]) if alpha else RGB
    is_float = kind in ("float", "double")
    values = [[v / scale if is_float else round(v / scale) for v in row] for row in wide]
    rows = [[(point, v) for v in x] for x in POINTS.tolist()]
    rows += [[("uchar", len(f)), *(("int", v) for v in f)] for f in FACES]
    first = 0 if per == "vertex" else 5
    for k in range(5 if per == "vertex" else 2):
        rows[first + k] = rows[first + k] + [(kind, v) for v in values[k]]
    if form == "ascii":
        body = "\n".join(" ".join(str(v) for _, v in row) for row in rows).encode() + b"\n"
    else:
        order = "<" if "little" in form else ">"
        body = b"".join(struct.pack(order + NUMBER[k], v) for row in rows for k, v in row)
    path.write_bytes("\n".join(head).encode() + body)
    return path


FORMS = ["ascii", "binary_little_endian", "binary_big_endian"]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    "kind, scale", [("uchar", 1.0), ("int", 1.0), ("float", 255.0), ("float", 1.0), ("double", 255)]
)
def test_ply_colors_of_points(tmp_path, form, kind, scale):
    found = surface_mesh.read(ply(tmp_path / "a.ply", form, kind, scale=scale))
    assert found.triangles.tolist() == TRIANGLES and (found.points == POINTS).all()
    assert np.allclose(found.rgb, RGB / 255, atol=1e-7)


@pytest.mark.parametrize("form", FORMS)
def test_ply_colors_of_faces_and_opacity(tmp_path, form):
    """As trimesh writes them: red, green, blue and alpha of each face."""
    found = surface_mesh.read(ply(tmp_path / "a.ply", form, per="face", alpha=True))
    assert found.rgb is None and found.triangles.tolist() == TRIANGLES
    assert np.allclose(found.triangle_rgb, RGB[[0, 0, 1]] / 255)
    cloud = surface_mesh.sample(found, 0.05, (0, 0, 0), 0.9, [1])
    square = cloud.x[:, 1] < 0.99
    assert np.allclose(cloud.rgb[square], RGB[0] / 255, atol=1e-6) and square.sum() > 1000
    assert np.allclose(cloud.rgb[cloud.x[:, 1] > 1.01], RGB[1] / 255, atol=1e-6)


@pytest.mark.parametrize("binary", [False, True])
def test_a_mesh_of_gmsh(tmp_path, binary):
    """Triangles and a quadrilateral of a file in gmsh's format 2.2, which meshio reads."""
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 2, 0], [0, 2, 0], [0, 0, 3]], float)
    cells = [("triangle", np.array([[0, 1, 4], [1, 2, 4]])), ("quad", np.array([[0, 3, 2, 1]]))]
    path = tmp_path / "a.msh"
    meshio.gmsh.write(path, meshio.Mesh(points, cells), "2.2", binary)
    mesh = surface_mesh.read(path)
    np.testing.assert_array_equal(mesh.points, points)
    np.testing.assert_array_equal(mesh.triangles, [[0, 1, 4], [1, 2, 4], [0, 3, 2], [0, 2, 1]])
    path.write_bytes(path.read_bytes()[:40])
    with pytest.raises(surface_mesh.MeshError, match="cannot be read|holds no") as error:
        surface_mesh.read(path)
    assert len(str(error.value).splitlines()) == 1


def test_ply_of_sixteen_bits_and_double_points(tmp_path):
    path = ply(tmp_path / "a.ply", FORMS[2], "ushort", scale=1 / 257.0, point="double")
    found = surface_mesh.read(path)
    assert np.allclose(found.rgb, RGB / 255, atol=1e-7)


def test_ply_with_other_elements_and_lists_of_many_lengths(tmp_path):
    """What comes before and between is passed over; polygons become fans in the file's order."""
    head = """ply
format binary_little_endian 1.0
element camera 1
property double f
property list uchar short lens
element vertex 5
property float x
property float y
property list uint uchar tags
property float z
element face 4
property list ushort uint vertex_index
property uchar flags
end_header
"""
    body = struct.pack("<dB3h", 1.5, 3, 7, 8, 9)
    for k, (x, y, z) in enumerate(POINTS):
        body += struct.pack("<ffI", x, y, k) + bytes(k) + struct.pack("<f", z)
    for face in ([0, 1, 2, 4, 3], [0, 1, 2], [0, 1], [0, 1, 2, 3]):
        body += struct.pack(f"<H{len(face)}IB", len(face), *face, 1)
    (tmp_path / "a.ply").write_bytes(head.encode() + body)
    found = surface_mesh.read(tmp_path / "a.ply")
    assert (found.points == POINTS).all()
    assert found.triangles.tolist() == [[0, 1, 2], [0, 2, 4], [0, 4, 3], [0, 1, 2],
                                        [0, 1, 2], [0, 2, 3]]  # fmt: skip


def surface():
    """The mesh as VTK's PolyData, with colors of its points."""
    faces = np.concatenate([[len(f), *f] for f in FACES])
    mesh = pyvista.PolyData(POINTS, faces)
    mesh.point_data["RGB"] = RGB.astype(np.uint8)
    return mesh


@pytest.mark.parametrize("name", ["a.ply", "b.ply", "a.vtk", "b.vtk", "a.vtp", "b.vtp"])
def test_what_pyvista_writes(tmp_path, name):
    path = tmp_path / name
    options = {"texture": "RGB"} if name.endswith("ply") else {}
    surface().save(path, binary=name[0] == "b", **options)
    found = surface_mesh.read(path)
    assert np.allclose(found.points, POINTS) and len(found.triangles) == 3
    assert np.allclose(found.rgb, RGB / 255)


@pytest.mark.parametrize("packing", ["LZ4", "ZLib", "LZMA", None])
def test_packed_grids_of_cells(tmp_path, packing):
    writer = vtkXMLUnstructuredGridWriter()
    writer.SetInputData(surface().cast_to_unstructured_grid())
    writer.SetFileName(str(tmp_path / "a.vtu"))
    if packing:
        getattr(writer, f"SetCompressorTypeTo{packing}")()
    else:
        writer.SetCompressorTypeToNone()
    writer.Write()
    found = surface_mesh.read(tmp_path / "a.vtu")
    assert np.allclose(found.points, POINTS) and len(found.triangles) == 3
    assert np.allclose(found.rgb, RGB / 255)


def test_colors_of_cells_and_the_surface_of_volumes(tmp_path):
    mesh = surface()
    mesh.clear_point_data()
    mesh.cell_data["colors"] = RGB[:2] / 255.0
    mesh.save(tmp_path / "a.vtp")
    found = surface_mesh.read(tmp_path / "a.vtp")
    assert found.rgb is None and np.allclose(found.triangle_rgb, RGB[[0, 0, 1]] / 255)
    pyvista.examples.cells.Hexahedron().save(tmp_path / "a.vtu")
    assert len(surface_mesh.read(tmp_path / "a.vtu").triangles) == 12
    pyvista.ImageData(dimensions=(3, 3, 3)).save(tmp_path / "image.vtk")
    with pytest.raises(MeshError, match="allowed are PolyData and UnstructuredGrid"):
        surface_mesh.read(tmp_path / "image.vtk")


# trimesh 4 writes a text file in this way: no name, no indentation
TRIMESH = """solid
facet normal 0.0 0.0 1.0
outer loop
vertex 0.0 0.0 0.0
vertex 1.0 0.0 0.0
vertex 1.0 1.0 0.0
endloop
endfacet
facet normal 0.0 0.0 1.0
outer loop
vertex 0.0 0.0 0.0
vertex 1.0e0 1.0 -0.0
vertex 0.0 1.0 0.0
endloop
endfacet
endsolid
"""


CHANGES = {
    "as it is": str,
    "capitals": str.upper,
    "a name": lambda text: text.replace("solid", "solid a b", 1),
    "empty lines": lambda text: text.replace("facet normal", "\nfacet normal"),
    "indented": lambda text: text.replace("\n", "\n  "),
    "one line": lambda text: text.replace("\n", " "),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_text_stl(tmp_path, change):
    (tmp_path / "a.stl").write_text(change(TRIMESH))
    found = surface_mesh.read(tmp_path / "a.stl")
    corners = [[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]]
    assert found.corners().tolist() == corners and len(found.points) == 4


def stl(header, words):
    """A binary file of triangles, with a word behind each."""
    data = header.ljust(80, b"\0") + struct.pack("<I", len(words))
    for k, word in enumerate(words):
        data += struct.pack("<12fH", 0, 0, 1, k, 0, 0, k + 1, 0, 0, k, 1, 0, word)
    return data


def test_binary_stl_with_colors(tmp_path):
    """Five bits each; VisCAM: bit 15 says that they count. Magics: that they do not."""
    red, green = 31 << 10, 31 << 5
    path = tmp_path / "a.stl"
    path.write_bytes(stl(b"solid by VisCAM", [0x8000 | red, 0x8000 | green, red]))
    found = surface_mesh.read(path).triangle_rgb
    assert found[:2].tolist() == [[1, 0, 0], [0, 1, 0]] and np.isnan(found[2]).all()
    path.write_bytes(stl(b"COLOR=" + bytes([255, 0, 51, 255]), [31, green, 0x8000]))
    found = surface_mesh.read(path).triangle_rgb
    assert np.allclose(found, [[1, 0, 0], [0, 1, 0], [1, 0, 0.2]])
    path.write_bytes(stl(b"plain", [0, 0, 0]))
    assert surface_mesh.read(path).triangle_rgb is None


@pytest.mark.parametrize("scale", [1, 255])
def test_obj_colors_of_points(tmp_path, scale):
    rows = [f"v {x} {y} {z} {r * scale / 255} {g * scale / 255} {b * scale / 255}"
            for (x, y, z), (r, g, b) in zip(POINTS, RGB)]  # fmt: skip
    (tmp_path / "a.obj").write_text("\n".join([*rows, "f 1 2 3 4", "f -2 -3 -1"]) + "\n")
    found = surface_mesh.read(tmp_path / "a.obj")
    assert found.triangles.tolist() == TRIANGLES and np.allclose(found.rgb, RGB / 255)


def test_obj_of_several_materials(tmp_path):
    """Their colors are those of the triangles; fewer texture coordinates than points are no
    fault, and a line may be continued."""
    (tmp_path / "a.mtl").write_text("newmtl r\nKd 1 0 0\nnewmtl g\nKd 0.25\nnewmtl none\nNs 3\n")
    text = "mtllib a.mtl\nvt 0.5 0.5\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in POINTS)
    text += "usemtl r\nf 1/1 2/1 \\\n3/1\nusemtl g\nf -5//1 -3//1 -2//1\nusemtl none\nf 4 3 5\n"
    (tmp_path / "a.obj").write_text(text)
    found = surface_mesh.read(tmp_path / "a.obj")
    assert found.triangles.tolist() == TRIANGLES and found.textures is None
    assert found.triangle_rgb[:2].tolist() == [[1, 0, 0], [0.25, 0.25, 0.25]]
    assert np.isnan(found.triangle_rgb[2]).all()
    assert "2 of its triangles, red 0.25 to 1.00" in inspect_file.describe_file(tmp_path / "a.obj")


def test_inspect_tells_where_colors_come_from(tmp_path):
    text = inspect_file.describe_file(ply(tmp_path / "a.ply", FORMS[1]))
    assert "a mesh of 3 triangles, 5 points\n" in text
    assert "colors   of its points, red 0.00 to 1.00, green 0.00 to 1.00, blue 0.01 to 0.98" in text
    (tmp_path / "a.stl").write_text(TRIMESH)
    assert "colors   none" in inspect_file.describe_file(tmp_path / "a.stl")
