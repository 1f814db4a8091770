"""Damaged mesh files: a mesh or one line, at once, and no more memory than the size explains."""

import base64
import functools
import lzma
import re
import struct
import tracemalloc
import zlib

import numpy as np
import pytest

from tests.support import damaged_meshes
from tests.support.peak_memory import read_apart
from vgmpi.preprocess.meshes import (
    bounded_reader,
    mesh_formats,
    mesh_topology,
    point_in_mesh,
    surface_mesh,
    triangle_mesh,
)
from vgmpi.preprocess.meshes.surface_mesh import MeshError
from vgmpi.preprocess.meshes.triangle_mesh import Mesh
from vgmpi.runtime import process_limits

FILES = 60  # damaged files of each format; VTK reads the last two by the same code

# reads the files of a folder; the peak memory is the kernel's, set back before each file
READ = """
import json, pathlib, resource, sys, time
from tests.support import peak_memory
from vgmpi.preprocess.meshes import surface_mesh
for path in sorted(pathlib.Path(sys.argv[1]).iterdir()):
    peak_memory.forget()
    begin = time.process_time()
    try:
        mesh = surface_mesh.read(path)
        said = f"{len(mesh.points)} points, {len(mesh.triangles)} triangles"
    except surface_mesh.MeshError as error:
        said = str(error)
    seconds = time.process_time() - begin
    child = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    print(json.dumps([path.name, seconds, peak_memory.megabytes(), child, said]))
"""


# name, seconds, peak memory [MB] here and of VTK's process, and words, by file
read_all = functools.partial(read_apart, READ)


@pytest.mark.parametrize("suffix", damaged_meshes.WAYS)
def test_damage_is_one_line_or_a_mesh(tmp_path, suffix):
    random = np.random.default_rng(sum(map(ord, suffix)))
    ways = damaged_meshes.WAYS[suffix]
    whole = [damaged_meshes.write_mesh(tmp_path / f"good{suffix}", way) for way in ways]
    folder = tmp_path / "damaged"
    folder.mkdir()
    count = FILES // 2 if suffix in (".vtp", ".vtu") else FILES
    for k in range(count):
        spoiled = damaged_meshes.damage(whole[k % len(whole)], random)
        (folder / f"{k:03}{suffix}").write_bytes(spoiled)
    found = read_all(folder)
    assert len(found) == count
    for name, seconds, peak, child, said in found:
        is_mesh = re.fullmatch(r"\d+ points, \d+ triangles", said)
        refused = said.startswith(f"{folder / name}: ") and "\n" not in said and len(said) < 500
        assert is_mesh or refused, said
        assert seconds < 1 and peak < 200 and child < 600, (name, said)
    refused = sum(said.startswith(str(folder)) for *_, said in found)
    assert count / 8 < refused < count  # bits of a color or of a position do no harm


def test_the_whole_files_are_read(tmp_path):
    for suffix, ways in damaged_meshes.WAYS.items():
        for way in ways:
            path = tmp_path / f"good{suffix}"
            damaged_meshes.write_mesh(path, way)
            found = surface_mesh.read(path)
            assert len(found.triangles) == 72 and (suffix == ".stl" or found.rgb is not None)


PACKERS = {"zlib": ("vtkZLibDataCompressor", zlib.compress),
           "lzma": ("vtkLZMADataCompressor", lzma.compress)}  # fmt: skip
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)


def write(path, compressor, size, *blocks, count=4):
    """A .vtu whose points are in these packed blocks of a size [bytes]."""
    head = struct.pack(f"<{3 + len(blocks)}I", len(blocks), size, 0, *map(len, blocks))
    points = base64.b64encode(head).decode() + base64.b64encode(b"".join(blocks)).decode()
    path.write_text(
        '<?xml version="1.0"?><VTKFile type="UnstructuredGrid" version="0.1"'
        f' byte_order="LittleEndian" header_type="UInt32" compressor="{compressor}">'
        f'<UnstructuredGrid><Piece NumberOfPoints="{count}" NumberOfCells="1"><Points>'
        '<DataArray type="Float64" Name="Points" NumberOfComponents="3" format="binary">'
        f"{points}</DataArray></Points><Cells>"
        '<DataArray type="Int64" Name="connectivity" format="ascii">0 1 2 3</DataArray>'
        '<DataArray type="Int64" Name="offsets" format="ascii">4</DataArray>'
        '<DataArray type="UInt8" Name="types" format="ascii">9</DataArray>'
        "</Cells></Piece></UnstructuredGrid></VTKFile>"
    )
    return path


@pytest.mark.parametrize("name", PACKERS)
def test_what_unpacks_to_far_more_than_the_file_is_refused(tmp_path, name):
    compressor, pack = PACKERS[name]
    halves = [pack(half.tobytes()) for half in (SQUARE[:2], SQUARE[2:])]
    found = surface_mesh.read(write(tmp_path / "a.vtu", compressor, 48, *halves))
    assert (found.points == SQUARE).all() and len(found.triangles) == 2
    size = 240 << 20  # bytes of each of two blocks
    bomb = pack(bytes(size))
    folder = tmp_path / "bomb"
    folder.mkdir()
    write(folder / "a.vtu", compressor, size, bomb, bomb, count=2 * size // 24)
    [(_, _, peak, child, said)] = read_all(folder)
    assert said.startswith(f"{folder / 'a.vtu'}: cannot be read as a mesh: ")
    assert (
        re.search("memory|Unable to allocate", said) and peak < 200 and child < 450
    )  # MB; 700 and more without a bound


@pytest.mark.parametrize(
    "name, text",
    [
        ("a.vtk", "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 900000000 float"),
        ("b.vtk", "# vtk DataFile Version 3.0\nx\nASCII\nDATASET STRUCTURED_POINTS\n"
         "DIMENSIONS 9999 9999 999\nORIGIN 0 0 0\nSPACING 1 1 1\n"),
        ("c.ply", "ply\nformat binary_little_endian 1.0\nelement vertex 900000000000\n"
         "property float x\nproperty float y\nproperty float z\nend_header\n"),
        ("d.ply", "ply\nformat ascii 1.0\nelement vertex 1\nproperty list uint float x\n"
         "end_header\n4294967295 1\n"),
        ("e.stl", "binary".ljust(80) + "\xff\xff\xff\x7f"),
    ],
)  # fmt: skip
def test_a_header_that_promises_too_much(tmp_path, name, text):
    (tmp_path / name).write_text(text, encoding="latin-1")
    [(_, seconds, peak, child, said)] = read_all(tmp_path)
    assert said.startswith(f"{tmp_path / name}: cannot be read as a mesh: ") and "\n" not in said
    assert seconds < 1 and peak < 200 and child < 450


@pytest.mark.parametrize("text", ["raise SystemExit(7)", "import os; os.abort()"])
def test_a_reader_that_ends_is_one_line(tmp_path, monkeypatch, text):
    program = tmp_path / "program.py"
    program.write_text(text)
    monkeypatch.setattr(bounded_reader, "_PROGRAM", program)
    (tmp_path / "a.vtp").write_bytes(b"any")
    with pytest.raises(MeshError, match="reader ended by (exit code 7|SIGABRT)"):
        surface_mesh.read(tmp_path / "a.vtp")


def test_a_reader_that_never_ends_is_stopped(tmp_path, monkeypatch):
    program = tmp_path / "program.py"
    program.write_text("import time; time.sleep(600)")
    monkeypatch.setattr(bounded_reader, "_PROGRAM", program)
    monkeypatch.setattr(bounded_reader, "_FREE_SECONDS", 0.5)
    (tmp_path / "a.vtp").write_bytes(b"any")
    with pytest.raises(MeshError, match="takes more than 0 s|takes more than 1 s"):
        surface_mesh.read(tmp_path / "a.vtp")


def test_a_face_of_many_corners_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(mesh_formats, "MAX_CORNERS", 5)
    path, points = tmp_path / "a.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
    path.write_text(f"{points}f 1 2 3 4 1\n")
    assert len(surface_mesh.read(path).triangles) == 3
    path.write_text(f"{points}f 1 2 3 4 1 \\\n2\n")
    with pytest.raises(MeshError, match="has a face of 6 corners: allowed 5"):
        surface_mesh.read(path)


def test_material_files_are_few_and_read_once(tmp_path, monkeypatch):
    monkeypatch.setattr(triangle_mesh, "MAX_LIBRARIES", 2)
    (tmp_path / "a.mtl").write_text("newmtl red\nKd 1 0 0\n")
    path = tmp_path / "a.obj"
    opened = []
    monkeypatch.setattr(
        triangle_mesh, "read_regular_file", lambda file, _: opened.append(file) or file.read_bytes()
    )
    assert triangle_mesh.read_materials(path, ["a.mtl"] * 9)["red"].color == (1, 0, 0)
    assert len(opened) == 1
    with pytest.raises(triangle_mesh.TextureError, match="names 3 material files: allowed 2"):
        triangle_mesh.read_materials(path, ["a.mtl", "./a.mtl", "././a.mtl"])


def test_triangles_at_one_place_take_no_more_memory_than_others():
    """Every line through the points meets all of them: 1.3 million crossings of 800 triangles."""
    x = np.array([[0, 0, 0], [1.0, 0, 0], [0, 1.0, 0.0]]) * 2
    mesh = Mesh(x, np.tile([[0, 1, 2]], (800, 1)))
    line = (np.arange(40) + 0.5) / 40
    points = np.stack(np.meshgrid(line, line, [0.5]), axis=-1).reshape(-1, 3)
    tracemalloc.start()
    point_in_mesh.inside(mesh, points, 1 / 40)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1.5e8


def test_points_that_coincide_are_counted_before_they_are_paired(monkeypatch):
    """Of n points at one place, n squared pairs would be listed."""
    monkeypatch.setattr(process_limits, "available_memory", lambda **_: 100_000)
    near = np.random.default_rng(0).random((300, 3)) * 1e-8
    x = np.concatenate([near, [[1.0, 0, 0], [0, 1.0, 0]]])
    mesh = Mesh(x, np.array([[k, 300, 301] for k in range(300)]))
    with pytest.raises(process_limits.InsufficientMemoryError, match="points that coincide"):
        mesh_topology.analyze_mesh(mesh)
