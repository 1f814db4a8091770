#!/usr/bin/env bash
# Package:  meshio 5.3.5, from PyPI; vtk 9.7.2 for comparison
# Behavior: negative vertex references of a Wavefront .obj file are read without an error and stand for
#           other vertices. The format counts them back from the last vertex before the face; meshio
#           subtracts 1 as from positive ones and keeps them negative, so that NumPy counts them from
#           the end of the whole file. Two unit squares side by side become faces of other corners.
# Expected: the vertices that the format means, as VTK reads them, or an error.
# Output seen:
#   vtk:    area 2.0, faces [[0, 1, 2, 3], [4, 5, 6, 7]]
#   meshio: area 4.0, faces [[-5, -4, -3, -2], [-5, -4, -3, -2]]
# Exits nonzero if this changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q --disable-pip-version-check meshio==5.3.5 vtk==9.7.2
cat > "$folder/squares.obj" <<'OBJ'
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
f -4 -3 -2 -1
v 2 0 0
v 3 0 0
v 3 1 0
v 2 1 0
f -4 -3 -2 -1
OBJ
"$folder/venv/bin/python" - "$folder/squares.obj" <<'PYTHON'
import sys
import meshio
import numpy as np
import vtk


def area(points, faces):
    """Sum of the areas of quadrilaterals, by their diagonals."""
    a, b, c, d = (points[faces[:, k]] for k in range(4))
    return float(np.linalg.norm(np.cross(c - a, d - b), axis=1).sum() / 2)


reader = vtk.vtkOBJReader()
reader.SetFileName(sys.argv[1])
reader.Update()
output = reader.GetOutput()
points = np.array([output.GetPoint(k) for k in range(output.GetNumberOfPoints())])
right = np.array([[output.GetCell(k).GetPointId(j) for j in range(4)] for k in range(output.GetNumberOfCells())])
mesh = meshio.read(sys.argv[1])
found = mesh.cells_dict["quad"]
print(f"vtk:    area {area(points, right)}, faces {right.tolist()}")
print(f"meshio: area {area(mesh.points, found)}, faces {found.tolist()}")
assert right.tolist() == [[0, 1, 2, 3], [4, 5, 6, 7]], "the behavior of vtk has changed"
assert found.tolist() == [[-5, -4, -3, -2]] * 2, "the behavior has changed"
PYTHON
