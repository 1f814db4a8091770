"""Multiphase physics on 3D Gaussians, from Python: docs/api.md.

    scene = vgmpi.load("scene.toml", {"domain.cell": "1 cm"})
    run = vgmpi.run(scene, on_frame=lambda run: print(run.time, run.array("x").mean(0)))

Nothing is loaded before it is asked for.
"""

import importlib
import os
import sys

# with colorama, where that is installed, numba ends every program with an escape code on stdout,
# which a file behind mpirun gets too; a numba that is there already has read its settings, and by a
# change would read all anew and forget device/jit.py's folder
if "numba" not in sys.modules:
    os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")

__all__ = ["Run", "SceneError", "load", "plan", "read", "run"]


def __getattr__(name: str):
    if name not in __all__:
        raise AttributeError(f"module 'vgmpi' has no attribute '{name}'")
    return getattr(importlib.import_module("vgmpi.api"), name)
