"""Meshes and points as files for other programs: .vtp and .pvd of VTK, .obj with colors."""

from pathlib import Path

import numpy as np

from vgmpi.runtime.user_files import replace_file

VTK_TYPES = {"f4": "Float32", "i4": "Int32", "i8": "Int64", "u1": "UInt8"}
VTP_HEAD = (
    '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">\n'
    '<PolyData>\n<Piece NumberOfPoints="{points}" NumberOf{kind}="{cells}">\n'
)
PVD = (
    '<VTKFile type="Collection" version="1.0" byte_order="LittleEndian">\n<Collection>\n'
    "{rows}</Collection>\n</VTKFile>\n"
)


def write_vtp(
    path: Path, vertices: np.ndarray, triangles: np.ndarray | None, fields: dict[str, np.ndarray]
) -> None:
    """Write a mesh or points as VTK's XML PolyData, with values at the vertices.

    Args:
        path: The file.
        vertices: Positions, shape (n, 3) [m].
        triangles: Numbers of the vertices, shape (m, 3); None for points.
        fields: Arrays of shape (n,) or (n, k); integers stay, all others are written as float32.

    Raises:
        OSError: The file cannot be written.
    """
    blocks: list[bytes] = []
    values = {k: v if v.dtype.kind in "iu" else v.astype("<f4") for k, v in fields.items()}
    kind = "Verts" if triangles is None else "Polys"
    cells = np.arange(len(vertices))[:, None] if triangles is None else triangles
    offsets = cells.shape[1] * np.arange(1, len(cells) + 1)
    text = VTP_HEAD.format(points=len(vertices), kind=kind, cells=len(cells))
    text += "<PointData>\n" + "".join(_array(k, v, blocks) for k, v in values.items())
    text += "</PointData>\n<Points>\n" + _array("Points", vertices.astype("<f4"), blocks)
    text += f"</Points>\n<{kind}>\n" + _array("connectivity", cells.astype("<i8").ravel(), blocks)
    text += _array("offsets", offsets.astype("<i8"), blocks)
    text += f'</{kind}>\n</Piece>\n</PolyData>\n<AppendedData encoding="raw">\n_'
    replace_file(path, text, *blocks, "\n</AppendedData>\n</VTKFile>\n")


def _array(name: str, values: np.ndarray, blocks: list[bytes]) -> str:
    """Return the element of an array and append its bytes to `blocks`."""
    offset = sum(map(len, blocks))
    data = np.ascontiguousarray(values).tobytes()
    blocks.append(np.uint64(len(data)).astype("<u8").tobytes() + data)
    width = values.shape[1] if values.ndim > 1 else 1
    kind = VTK_TYPES[values.dtype.str[1:]]
    return (
        f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{width}" format="appended"'
        f' offset="{offset}"/>\n'
    )


def write_obj(path: Path, vertices: np.ndarray, triangles: np.ndarray, rgb: np.ndarray) -> None:
    """Write a mesh as Wavefront OBJ, a color behind the position of each vertex.

    Args:
        path: The file.
        vertices: Positions, shape (n, 3) [m].
        triangles: Numbers of the vertices, shape (m, 3).
        rgb: Colors in 0..1, shape (n, 3).

    Raises:
        OSError: The file cannot be written.
    """
    rows = np.column_stack([vertices, rgb]).tolist()
    lines = ["v {:.7g} {:.7g} {:.7g} {:.4g} {:.4g} {:.4g}\n".format(*row) for row in rows]
    lines += ["f {} {} {}\n".format(*row) for row in (triangles + 1).tolist()]
    replace_file(path, "".join(lines))


def write_pvd(path: Path, files: dict[str, float]) -> None:
    """Write the list that makes a time series of .vtp files.

    Args:
        path: The file.
        files: Times [s] by the names of files in its folder.

    Raises:
        OSError: The file cannot be written.
    """
    rows = "".join(f'<DataSet timestep="{t!r}" file="{name}"/>\n' for name, t in files.items())
    replace_file(path, PVD.format(rows=rows))
