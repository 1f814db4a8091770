"""Multiphase physics on 3D Gaussians, from Python.

    scene = vgmpi.load("scene.toml", {"domain.cell": "1 cm"})
    run = vgmpi.run(scene, on_frame=lambda run: print(run.time, run.array("positions").mean(0)))
    with vgmpi.simulate(scene) as sim: ...  # step by step

Nothing is imported before it is used. See docs/tutorial/python.md.
"""

import importlib
import os
import sys

# With colorama installed, numba ends every program with an escape code on stdout, and a file behind
# mpirun gets it too. A numba that is already imported has read its settings: a change would make it
# read them all again, and forget those that a program has set.
if "numba" not in sys.modules:
    os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")

__all__ = ["Run", "SceneError", "load", "open_run", "plan", "read", "run", "simulate"]


def __getattr__(name: str):
    if name == "__version__":
        return importlib.import_module("vgmpi.runtime.versions").program_version()
    if name not in __all__:
        raise AttributeError(f"module 'vgmpi' has no attribute '{name}'")
    module = "vgmpi.tools.notebook.opened_run" if name == "open_run" else "vgmpi.api"
    return getattr(importlib.import_module(module), name)
