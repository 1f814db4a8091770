"""Mesh files of every format, and damage to them by a fixed seed."""

import re
from pathlib import Path

import numpy as np
import pyvista
from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

_NUMBERS = (b"-1", b"0", b"7", b"255", b"99999", b"4294967295", b"999999999999999", b"1e308", b"x")
_WORDS = (b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\0", b"\0\0\0\x80", b"\x7f\xff\xff\xff")
WAYS = {
    ".ply": ("text", "binary"),
    ".stl": ("text", "binary"),
    ".obj": ("text",),
    ".vtk": ("text", "binary"),
    ".vtp": ("text", "LZ4", "ZLib", "LZMA"),
    ".vtu": ("text", "LZ4", "ZLib", "LZMA"),
}


def write_mesh(path: Path, way: str) -> bytes:
    """Write a colored ball with quads and triangles, and return the bytes."""
    ball = pyvista.Sphere(radius=1.0, theta_resolution=8, phi_resolution=6, direction=(0, 0, 1))
    mesh = ball.append_polydata(pyvista.Plane(i_resolution=2, j_resolution=2))
    mesh.clear_data()
    mesh.point_data["RGB"] = (np.arange(3 * mesh.n_points) % 256).astype("u1").reshape(-1, 3)
    if path.suffix in (".ply", ".stl", ".vtk"):
        options = {"texture": "RGB"} if path.suffix == ".ply" else {}
        mesh.save(path, binary=way == "binary", **options)
    elif path.suffix == ".obj":
        rows = [f"v {x} {y} {z} 1 0 0.5" for x, y, z in mesh.points]
        rows += ["f " + " ".join(f"{k + 1}/{k + 1}" for k in face) for face in mesh.irregular_faces]
        path.write_text("\n".join([*rows[: mesh.n_points], "vt 0 1", *rows[mesh.n_points :]]))
    else:
        is_grid = path.suffix == ".vtu"
        writer = vtkXMLUnstructuredGridWriter() if is_grid else vtkXMLPolyDataWriter()
        writer.SetInputData(mesh.cast_to_unstructured_grid() if is_grid else mesh)
        writer.SetFileName(str(path))
        if way == "text":
            writer.SetDataModeToAscii()
        else:
            getattr(writer, f"SetCompressorTypeTo{way}")()
        writer.Write()
    return path.read_bytes()


def damage(data: bytes, random: np.random.Generator) -> bytes:
    """Return the bytes of a file with bits turned, cut off, or with wrong numbers."""
    out = bytearray(data)
    kind = random.integers(4)
    if kind == 0:  # bits
        for place in random.integers(0, 8 * len(out), random.integers(1, 9)):
            out[place // 8] ^= 1 << (place % 8)
    elif kind == 1:  # an end too early
        del out[random.integers(0, len(out)) :]
    elif kind == 2:  # a number in text: a count, a size, an offset
        found = list(re.finditer(rb"(?<![\w.])\d+(?![\w.])", data[: max(600, len(data) // 2)]))
        if found:
            match = found[random.integers(len(found))]
            out[match.start() : match.end()] = _NUMBERS[random.integers(len(_NUMBERS))]
    else:  # a number in binary
        place = random.integers(0, max(1, len(out) - 4))
        out[place : place + 4] = _WORDS[random.integers(len(_WORDS))]
    return bytes(out)
