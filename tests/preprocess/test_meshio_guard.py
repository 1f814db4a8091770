"""Meshes that meshio reads take no more than their size can explain."""

import base64
import lzma
import struct
import tracemalloc
import zlib

import numpy as np
import pytest

from vgmpi.preprocess.meshes import meshio_guard, surface_mesh
from vgmpi.preprocess.meshes.surface_mesh import MeshError

PACKERS = {"zlib": ("vtkZLibDataCompressor", zlib.compress),
           "lzma": ("vtkLZMADataCompressor", lzma.compress)}  # fmt: skip
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)


def write(path, compressor, *blocks):
    """A .vtu whose points are in these packed blocks."""
    sizes = [len(block) for block in blocks]
    head = struct.pack(f"<{3 + len(blocks)}I", len(blocks), 1 << 20, 1 << 20, *sizes)
    points = base64.b64encode(head).decode() + base64.b64encode(b"".join(blocks)).decode()
    path.write_text(
        '<?xml version="1.0"?><VTKFile type="UnstructuredGrid" version="0.1"'
        f' byte_order="LittleEndian" header_type="UInt32" compressor="{compressor}">'
        '<UnstructuredGrid><Piece NumberOfPoints="4" NumberOfCells="1"><Points>'
        '<DataArray type="Float64" Name="Points" NumberOfComponents="3" format="binary">'
        f"{points}</DataArray></Points><Cells>"
        '<DataArray type="Int64" Name="connectivity" format="ascii">0 1 2 3</DataArray>'
        '<DataArray type="Int64" Name="offsets" format="ascii">4</DataArray>'
        '<DataArray type="Int64" Name="types" format="ascii">9</DataArray>'
        "</Cells></Piece></UnstructuredGrid></VTKFile>"
    )
    return path


@pytest.mark.parametrize("name", PACKERS)
def test_a_packed_mesh_is_read(tmp_path, name):
    compressor, pack = PACKERS[name]
    halves = (pack(half.tobytes()) for half in (SQUARE[:2], SQUARE[2:]))
    found = surface_mesh.read(write(tmp_path / "a.vtu", compressor, *halves))
    assert (found.points == SQUARE).all() and len(found.triangles) == 2


@pytest.mark.parametrize("blocks", [1, 4])
@pytest.mark.parametrize("name", PACKERS)
def test_what_unpacks_to_far_more_than_the_file_is_refused(tmp_path, name, blocks):
    compressor, pack = PACKERS[name]
    bomb = pack(bytes((240 << 20) // blocks))
    path = write(tmp_path / "a.vtu", compressor, *[bomb] * blocks)
    tracemalloc.start()
    try:
        with pytest.raises(MeshError, match="unpack to more than 67,108,864") as caught:
            surface_mesh.read(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)
    assert peak < 200 << 20  # bytes; 480 MB and more without a bound


@pytest.mark.parametrize("name", PACKERS)
def test_a_packed_array_that_is_cut_off(tmp_path, name):
    compressor, pack = PACKERS[name]
    path = write(tmp_path / "a.vtu", compressor, pack(SQUARE.tobytes())[:-9])
    with pytest.raises(MeshError, match="cut off"):
        surface_mesh.read(path)


def test_meshio_is_as_before(tmp_path):
    from meshio.vtu import _vtu

    path = write(tmp_path / "a.vtu", PACKERS["zlib"][0], b"nothing")
    with pytest.raises(ValueError), meshio_guard.limited(path):
        raise ValueError
    assert _vtu.zlib is zlib and _vtu.lzma is lzma
