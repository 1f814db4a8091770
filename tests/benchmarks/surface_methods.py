"""Ways to make the surface of particles, side by side: ours, pysplashsurf as its page recommends,
and VTK's own SPH filter with a contour.
"""

import time

import numpy as np
import pysplashsurf
import pyvista
from vtkmodules.vtkFiltersPoints import vtkSPHCubicKernel, vtkSPHInterpolator

from vgmpi.postprocess.export.particle_surface import reconstruct_surface

H = 0.005  # [m] distance of particles; a cell is twice as wide
POOL = (0.16, 0.16, 0.08)


def lattice(size, jitter=0.0) -> np.ndarray:
    """Positions of particles that fill a box, moved by up to `jitter` distances."""
    x = (np.indices(np.rint(np.array(size) / H).astype(int)).reshape(3, -1).T + 0.5) * H
    return x + H * np.random.default_rng(1).uniform(-jitter, jitter, x.shape)


def ours(x):
    """The mesh of vgmpi export, without walls."""
    mesh = reconstruct_surface(x, H, {})
    return pyvista.PolyData.from_regular_faces(mesh.vertices, mesh.triangles)


def recommended(x):
    """pysplashsurf with the settings of its own page."""
    result, _ = pysplashsurf.reconstruction_pipeline(
        x, particle_radius=0.5 * H, smoothing_length=2.0, cube_size=0.5,
        iso_surface_threshold=0.6, mesh_smoothing_weights=True, mesh_smoothing_iters=25,
        mesh_cleanup=True,
    )  # fmt: skip
    triangles = np.array(result.mesh.triangles).astype(np.int64)
    return pyvista.PolyData.from_regular_faces(np.array(result.mesh.vertices), triangles)


def by_vtk(x):
    """VTK's cubic SPH kernel, a contour at one half, and Taubin smoothing."""
    low, step = x.min(0) - 3 * H, 0.5 * H
    counts = np.ceil((x.max(0) + 3 * H - low) / step).astype(int) + 1
    grid = pyvista.ImageData(dimensions=counts, spacing=(step,) * 3, origin=low)
    cloud = pyvista.PolyData(x)
    cloud["density"], cloud["mass"] = np.ones(len(x)), np.full(len(x), H**3)
    kernel, sums = vtkSPHCubicKernel(), vtkSPHInterpolator()
    kernel.SetSpatialStep(1.5 * H)
    sums.SetInputData(grid)
    sums.SetSourceData(cloud)
    sums.SetKernel(kernel)
    sums.SetDensityArrayName("density")
    sums.SetMassArrayName("mass")
    sums.SetNullPointsStrategyToNullValue()
    sums.Update()
    surface = pyvista.wrap(sums.GetOutput()).contour([0.5], sums.GetShepardSumArrayName())
    return surface.smooth_taubin(n_iter=25, pass_band=0.1) if surface.n_points else surface


METHODS = {"vgmpi export": ours, "pysplashsurf, its page": recommended, "VTK": by_vtk}


def measure(method) -> dict[str, float]:
    """Flatness [cells] of a pool of irregular particles, and volumes over those put in."""
    x = lattice(POOL, 0.3)
    begin = time.perf_counter()
    mesh = method(x)
    seconds = time.perf_counter() - begin
    inner = (np.abs(mesh.points[:, :2] - 0.08) < 0.05).all(1) & (mesh.points[:, 2] > 0.06)
    volumes = {
        name: method(lattice(size)).volume / np.prod(size)
        for name, size in (("one", (H,) * 3), ("eight", (2 * H,) * 3), ("layer", (0.06, 0.06, H)))
    }
    ends = mesh.extract_feature_edges(feature_edges=False, manifold_edges=False)
    return {
        "deviation": float(np.abs(mesh.points[inner, 2] - POOL[2]).max() / (2 * H)),
        "open": ends.n_cells,
        "pool": mesh.volume / np.prod(POOL),
        **volumes,
        "seconds": seconds,
    }


def text() -> str:
    """Table of all methods."""
    head = "| method | pool flat to [cells] | open edges | volume of pool | of one particle |"
    rows = [f"{head} of eight | of a layer | time [s] |", "|---" * 8 + "|"]
    for name, method in METHODS.items():
        m = measure(method)
        cells = [f"{m['deviation']:.3f}", f"{m['open']}", f"{m['pool']:.3f}"]
        cells += [f"{m[k]:.2f}" for k in ("one", "eight", "layer")] + [f"{m['seconds']:.1f}"]
        rows.append("| " + " | ".join([name, *cells]) + " |")
    return "\n".join(rows)
