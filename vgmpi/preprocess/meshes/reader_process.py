"""Program that reads one mesh by a library and writes its triangles to standard output, as .npz.

It runs apart from vgmpi, with bounds on its memory and time, since the libraries trust a file.
It is called as `python reader_process.py FILE BYTES triangles`, or `points` for the points of a
file with all of their arrays, and ends with code 2 and one line of
text where the file cannot be read. It imports nothing of vgmpi.
"""

import os
import resource
import sys

import numpy as np

REFUSED = 2  # [-] exit code


def main(path: str, allowance: int, content: str) -> None:
    """Write the triangles of a file, or its points.

    Args:
        path: The file.
        allowance: Memory that it may take [bytes].
        content: "triangles" or "points".
    """
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what VTK prints is no result

    def refuse(reason: str) -> None:
        """End the program with one line."""
        output.write(reason.splitlines()[0].encode() if reason.strip() else b"is damaged")
        output.flush()
        os._exit(REFUSED)  # at once: after a reader's first error nothing it holds is of use

    if path.lower().endswith(".msh"):
        _write_gmsh(path, allowance, output, refuse)
        return
    from vtkmodules.vtkCommonCore import vtkOutputWindow
    from vtkmodules.vtkCommonDataModel import vtkPolyData, vtkUnstructuredGrid

    window = vtkOutputWindow.GetInstance()
    window.SetDisplayModeToNever()

    def report(_window, _event, text) -> None:
        """Refuse the file for an error of VTK."""
        refuse(_reason(text))

    report.CallDataType = "string0"  # type: ignore[attr-defined]
    window.AddObserver("ErrorEvent", report)  # type: ignore[arg-type]
    reader = _reader(path)
    _limit_memory(allowance)
    try:
        reader.SetFileName(path)
        reader.Update()
        data = reader.GetOutputDataObject(0)
        if not isinstance(data, vtkPolyData | vtkUnstructuredGrid):
            name = "nothing" if data is None else data.GetClassName().removeprefix("vtk")
            refuse(f"holds {name}: allowed are PolyData and UnstructuredGrid")
        arrays = _point_arrays(data) if content == "points" else _triangle_arrays(data)
        np.savez(output, **arrays)  # type: ignore[arg-type]
        output.flush()
    except MemoryError:
        refuse("needs more memory than its size explains")
    except Exception as error:
        refuse(str(error))


def _write_gmsh(path: str, allowance: int, output, refuse) -> None:
    """Write the triangles and quadrilaterals of a file of gmsh, by meshio."""
    import meshio.gmsh

    _limit_memory(allowance)
    try:
        mesh = meshio.gmsh.read(path)
        cells = {kind: mesh.get_cells_type(kind) for kind in ("triangle", "quad")}
        quads = cells["quad"].reshape(-1, 4)
        triangles = np.concatenate(
            [cells["triangle"].reshape(-1, 3), quads[:, (0, 1, 2)], quads[:, (0, 2, 3)]]
        )
        np.savez(output, points=mesh.points.astype(np.float64), triangles=triangles)
        output.flush()
    except MemoryError:
        refuse("needs more memory than its size explains")
    except Exception as error:
        refuse(str(error) or "is no file of gmsh, or damaged")


def _reader(path: str):
    """Return VTK's reader of a file."""
    if path.lower().endswith(".vtk"):
        from vtkmodules.vtkIOLegacy import vtkGenericDataObjectReader

        reader = vtkGenericDataObjectReader()
        for switch in ("Scalars", "Vectors", "ColorScalars", "Fields"):
            getattr(reader, f"ReadAll{switch}On")()
        return reader
    from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLUnstructuredGridReader

    is_grid = path.lower().endswith(".vtu")
    return vtkXMLUnstructuredGridReader() if is_grid else vtkXMLPolyDataReader()


def _limit_memory(allowance: int) -> None:
    """Let this process take `allowance` bytes more than it has now."""
    with open("/proc/self/statm") as file:
        size = int(file.read().split()[0]) * resource.getpagesize()
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    limit = size + allowance if hard == resource.RLIM_INFINITY else min(size + allowance, hard)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))


def _reason(text: str) -> str:
    """Return the message in VTK's report of an error: it follows the object's address."""
    lines = [line for line in text.splitlines() if line.strip()]
    line = next((each for each in lines if "): " in each), lines[-1] if lines else "")
    return line.partition("): ")[2] or line


def _check_cells(data) -> None:
    """Check the cells of a dataset before a filter follows their numbers. Raises ValueError."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    points = data.GetNumberOfPoints()
    arrays = (
        [data.GetPolys(), data.GetStrips(), data.GetVerts(), data.GetLines()]
        if hasattr(data, "GetPolys")
        else [data.GetCells()]
    )
    for cells in arrays:
        if cells is None or not cells.GetNumberOfCells():
            continue
        offsets = vtk_to_numpy(cells.GetOffsetsArray()).astype(np.int64)
        corners = vtk_to_numpy(cells.GetConnectivityArray())
        if (
            offsets[0] != 0
            or (np.diff(offsets) < 0).any()
            or offsets[-1] != len(corners)
            or (len(corners) and not 0 <= corners.min() <= corners.max() < points)
        ):
            raise ValueError("has cells without points")


def _arrays(mesh) -> dict[str, np.ndarray]:
    """Return points, triangles, and arrays of three or four numbers of both."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    if mesh.GetPoints() is None or not mesh.GetNumberOfPolys():
        return {"points": np.empty((0, 3)), "triangles": np.empty((0, 3), np.int64)}
    out = {
        "points": vtk_to_numpy(mesh.GetPoints().GetData()).astype(np.float64),
        "triangles": vtk_to_numpy(mesh.GetPolys().GetConnectivityArray()).reshape(-1, 3),
    }
    for place, table in (("point", mesh.GetPointData()), ("cell", mesh.GetCellData())):
        for k in range(table.GetNumberOfArrays()):
            array = table.GetArray(k)  # None for texts
            if array is not None and array.GetNumberOfComponents() in (1, 3, 4):
                name = (array.GetName() or "").lower()
                values = vtk_to_numpy(array)
                if _is_color(name, values):
                    out[f"{place} {name}"] = values
    return out


def _triangle_arrays(data) -> dict[str, np.ndarray]:
    """Return the triangles of a dataset, of volume cells those of their surface."""
    from vtkmodules.vtkCommonDataModel import vtkUnstructuredGrid
    from vtkmodules.vtkFiltersCore import vtkTriangleFilter
    from vtkmodules.vtkFiltersGeometry import vtkGeometryFilter

    _check_cells(data)
    if isinstance(data, vtkUnstructuredGrid):
        outside = vtkGeometryFilter()
        outside.SetInputData(data)
        outside.Update()
        data = outside.GetOutput()
    cut = vtkTriangleFilter()
    cut.PassVertsOff()
    cut.PassLinesOff()
    cut.SetInputData(data)
    cut.Update()
    return _arrays(cut.GetOutput())


def _point_arrays(data) -> dict[str, np.ndarray]:
    """Return the points of a dataset, and their arrays by name in small letters."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    if data.GetPoints() is None:
        return {"points": np.empty((0, 3))}
    out = {"points": vtk_to_numpy(data.GetPoints().GetData()).astype(np.float64)}
    table = data.GetPointData()
    for k in range(table.GetNumberOfArrays()):
        array = table.GetArray(k)  # None for texts
        if array is not None:
            out[f"point {(array.GetName() or '').lower()}"] = vtk_to_numpy(array)
    return out


def _is_color(name: str, values: np.ndarray) -> bool:
    """Return whether an array is a color: by its name, or as VTK's own colors by its type."""
    if values.ndim == 1:
        return name in ("red", "green", "blue")
    named = name in ("rgb", "rgba", "color", "colors", "vertex_colors")
    return named or values.dtype == np.uint8


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3])
