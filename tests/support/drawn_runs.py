"""A small run on disk, as the program writes it: a pool of balls, a turning bar, a floor."""

import numpy as np

from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.io import file_layout, initial_state
from vgmpi.io.frames import Frames
from vgmpi.io.run_reader import read_gaussians
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.solver.initial_particles import prepare, write_initial_particles

WATER, BAR = 6**3, 40
REST = np.eye(3)  # no deformation
CELLS = 5  # along the domain of a run with a cell
BLUE, RED, BROWN = (0.2, 0.4, 0.9), (0.9, 0.1, 0.1), (0.5, 0.4, 0.3)


def on_paper(text):
    """A render.toml that draws Gaussians as they are."""
    if "[look]" in text:
        return text.replace("[look]", '[look]\npreset = "paper"')
    return 'look.preset = "paper"\n' + text


def rotation(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def sh(rgb, n, k=1):
    out = np.zeros((n, k, 3), dtype="f4")
    out[:, 0] = dc_from_rgb(np.array(rgb))
    return out


def diagonal(xx, yy, zz, n):
    return np.tile(np.array([xx, 0, 0, yy, 0, zz]), (n, 1)).astype("f4")


def rest_state(opacity_scale=0.5, k=1):
    """Rows of gaussians.h5, the objects and the scenery; the domain is 1 m wide."""
    h = 0.1
    water = (np.indices((6, 6, 6)).reshape(3, -1).T + 0.5) * h + [0.2, 0.2, 0.0]
    bar = np.stack([np.linspace(0.2, 0.8, BAR), np.full(BAR, 0.5), np.full(BAR, 0.85)], axis=1)
    n = WATER + BAR
    rows = {
        "x0": np.concatenate([water, bar]),
        "vol0": np.full(n, h**3),
        "object": np.repeat([0, 1], [WATER, BAR]).astype("i4"),
        "cov0": np.concatenate(
            [diagonal(1e-9, 1e-9, 1e-9, WATER), diagonal(0.02**2, 0.01**2, 0.04**2, BAR)]
        ),
        "opacity": np.full(n, 0.8, "f4"),
        "sh": np.concatenate([sh(BLUE, WATER, k), sh(RED, BAR, k)]),
    }
    objects = [
        {"name": "pool", "family": "fluid", "opacity_scale": opacity_scale, "alpha_min": None},
        {"name": "bar", "family": "solid", "opacity_scale": 0.001, "alpha_min": None},
        {"name": "floor", "family": None, "role": "scenery"},
    ]
    ground = np.stack(np.meshgrid(*(np.linspace(0, 1, 20),) * 2, [0.0]), -1).reshape(-1, 3)
    scenery = {
        "x0": ground,
        "object": np.full(len(ground), 2, "i4"),
        "cov0": diagonal(0.03**2, 0.03**2, 1e-6, len(ground)),
        "opacity": np.full(len(ground), 0.9, "f4"),
        "sh": sh(BROWN, len(ground)),
    }
    return rows, objects, scenery


def frame_fields(rows, k, frames):
    """Fields of frame k: the water sinks and swells, the bar turns about the vertical."""
    part = k / max(frames - 1, 1)
    x = rows["x0"].copy()
    R = rotation(0.5 * np.pi * part)
    middle = np.array([0.5, 0.5, 0.85])
    x[WATER:] = (x[WATER:] - middle) @ R.T + middle
    x[:WATER, 2] *= 1 - 0.2 * part
    F = np.tile(np.eye(3), (len(x), 1, 1))
    F[WATER:] = R
    J = np.ones(len(x))
    J[:WATER] = 1 + 0.1 * part
    velocity = np.zeros_like(x)
    velocity[:, 2] = x[:, 0]
    fields = {"positions": x, "velocity": velocity, "J": J, "F": F.reshape(-1, 9)}
    return {name: a.astype("f4") for name, a in fields.items()} | {"object": rows["object"]}


def enlarged(arrays, scale):
    """Arrays of a run that is `scale` times as large."""
    powers = {"x0": 1, "positions": 1, "cov0": 2, "vol0": 3}
    return {
        name: a * np.asarray(scale ** powers[name], a.dtype) if name in powers else a
        for name, a in arrays.items()
    }


def write(folder, frames=3, scene=True, height=1.0, cell=None, **options):
    """Write the run into `folder` and return it.

    cell: edge of a cell [m]; the domain is then CELLS of them wide, and else 1 m.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rows, objects, scenery = rest_state(**options)
    scale = 1.0 if cell is None else cell * CELLS
    scene = {"domain": {"size": [scale, scale, scale * height]}} if scene else {}
    if cell is not None:
        scene["domain"]["cell"] = cell
    scaled = [enlarged(part, scale) for part in (rows, scenery)]
    initial_state.write(
        folder / file_layout.GAUSSIANS, SerialCommunicator(), scaled[0], objects, scaled[1], scene
    )
    files = Frames(folder, SerialCommunicator(), len(rows["x0"]))
    for k in range(frames):
        fields = enlarged(frame_fields(rows, k, frames), scale)
        files.write(k, 0.04 * k, k, np.arange(len(rows["x0"])), fields)
    return folder


def write_run(scene, folder, F=REST, middle=0.0):
    """Write the run of a scene with one frame, deformed by F (3, 3) about a point; return it."""
    alone = SerialCommunicator()
    write_initial_particles(scene, prepare(scene, alone, folder), alone, folder)
    rest = read_gaussians(folder / file_layout.GAUSSIANS)
    n = len(rest.x0)
    fields = {
        "positions": (rest.x0 - middle) @ F.T + middle,
        "velocity": np.zeros((n, 3)),
        "J": np.full(n, np.linalg.det(F)),
        "F": np.tile(F.ravel(), (n, 1)),
    }
    fields = {name: values.astype("f4") for name, values in fields.items()}
    fields["object"] = np.asarray(rest.object)
    Frames(folder, alone, n).write(0, 0.0, 0, np.arange(n), fields)
    return folder
