#!/usr/bin/env bash
# meshio 5.3.5 writes "a.msh" in ANSYS Fluent's format, not in gmsh's: the suffix belongs to both,
# and the first in its table is taken without a word. meshio's own reader of gmsh refuses such a file
# with an error that has no text. file_format="gmsh" is needed to write what gmsh reads.
#
# Seen (Python 3.11, Linux):
#   default.msh begins with (1 "meshio 5.3.5"); read as gmsh: ReadError('')
#   named.msh begins with $MeshFormat; read as gmsh: 2 triangles
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip -q --disable-pip-version-check install meshio==5.3.5 "numpy<3" 2>/dev/null
cat > write.py <<'PYTHON'
import meshio
import meshio.gmsh
import numpy as np

points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
mesh = meshio.Mesh(points, [("triangle", np.array([[0, 1, 2], [0, 2, 3]]))])
mesh.write("default.msh")
mesh.write("named.msh", file_format="gmsh")
for name in ("default.msh", "named.msh"):
    first = open(name, "rb").readline().decode().strip()
    try:
        found = f"{len(meshio.gmsh.read(name).get_cells_type('triangle'))} triangles"
    except meshio.ReadError as error:
        found = f"ReadError({str(error)!r})"
    print(f"{name} begins with {first}; read as gmsh: {found}")
    want = {"default.msh": ('(1 "meshio 5.3.5"', "ReadError('')"), "named.msh": ("$Mesh", "2 tri")}[name]
    assert first.startswith(want[0]) and found.startswith(want[1]), "changed"
PYTHON
env/bin/python write.py
