#!/usr/bin/env bash
# Package:  viser 1.1.1, from PyPI
# Behavior: add_gaussian_splats stores covariances as float16 in squared scene units, whatever their
#           size: Gaussians with standard deviations below 1.7e-4 units have covariance 0, those of
#           1e-3 units are 1 % off, and those of 300 units are infinite. Only the overflow causes a
#           warning, that of NumPy.
# Expected: covariances scaled to the range of float16, or an error.
# Output seen, after viser's own lines (standard deviation: stored variance):
#   0.0001: stored variance 0.0
#   0.0003: stored variance 1.1920928955078125e-07, error 32.5%
#   0.001: stored variance 1.0132789611816406e-06, error 1.3%
#   1: stored variance 1.0, error 0.0%
#   300: stored variance inf
# Exits nonzero if this changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q --disable-pip-version-check viser==1.1.1
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import socket
import numpy as np
import viser

with socket.socket() as free:
    free.bind(("127.0.0.1", 0))
    port = free.getsockname()[1]
server = viser.ViserServer("127.0.0.1", port, verbose=False)
sizes = np.array([1e-4, 3e-4, 1e-3, 1.0, 300.0])
n = len(sizes)
node = server.scene.add_gaussian_splats(
    "/gaussians", centers=np.zeros((n, 3)), covariances=sizes[:, None, None] ** 2 * np.eye(3),
    rgbs=np.ones((n, 3)), opacities=np.ones((n, 1)),
)
stored = np.ascontiguousarray(node.buffer[:, 4:7]).view(np.float16)[:, 0].astype(float)
for size, variance in zip(sizes, stored):
    error = "" if variance in (0, np.inf) else f", error {abs(variance / size**2 - 1):.1%}"
    print(f"{size:g}: stored variance {variance}{error}")
server.stop()
assert stored[0] == 0 and np.isinf(stored[4]), "the behavior has changed"
assert 0.2 < abs(stored[1] / sizes[1] ** 2 - 1) < 0.5 and stored[3] == 1, "the behavior has changed"
PYTHON
