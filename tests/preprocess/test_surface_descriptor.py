"""What contact knows of the surfaces of solids at rest: normals, distances and how they turn."""

from dataclasses import replace

import meshio
import numpy as np
import pytest

from tests.preprocess.test_scene_builder import egg
from tests.preprocess.test_surface_mesh import ball
from tests.support.simulate import begin
from tests.support.small_scenes import ROOM, scene
from vgmpi.gaussians.formats import ply
from vgmpi.io import file_layout
from vgmpi.io.run_reader import read_gaussians
from vgmpi.kernels.nodal_fields.surface_distance import MAX_DEPTH_CELLS
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.planning.particle_channels import CURVATURE_TO_FULL
from vgmpi.preprocess.built_object import CURVATURE_WEIGHT, MAX_NORMAL_TURN_PER_CELL
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.solver.initial_particles import known_of, plan_for, prepare, write_initial_particles
from vgmpi.solver.simulation import Simulation

DX = 0.02
MIDDLE = np.array([0.2, 0.2, 0.2])
RADIUS = 0.08
POST = """
[[object]]
name = "post"
role = "scenery"
collider = true
shape = { box = [[0, 0, 0], [0.02, 0.02, 0.02]] }
position = [0.02, 0.02, 0.02]
"""
SPHERE = "shape = { sphere = { center = [0, 0, 0], radius = 0.08 } }"
BOX = "shape = { box = [[-0.08, -0.07, 0], [0.08, 0.07, 0.12]] }"
HALF = np.array([0.08, 0.07, 0.06])


def body(form, height, boundary="", name="body"):
    """A scene's text of one solid whose foot is at a height [m], and a post that it may touch."""
    return ROOM.replace("cell = 0.02", f"cell = 0.02\n{boundary}") + (
        f'[[object]]\nname = "{name}"\nmaterial = "clay"\n{form}\n'
        f"position = [0.2, 0.2, {height}]\n{POST}"
    )


def surfaces(folder, text):
    """(x (n, 3) [m], surface0 (n, 10)) of a scene's bodies."""
    made = build_scene(scene(folder, text))
    assert made.surface0.shape == (len(made.x), 10) and made.surface0.dtype == np.float32
    assert np.isfinite(made.surface0).all()
    return made.x, made.surface0.astype(np.float64)


def angles(surface, normal):
    """[degrees] (n,) between normals (n, 3) and those of the surface (n, 10)."""
    size = np.linalg.norm(surface[:, :3], axis=1)
    assert (size > 0).all() and (size <= 1 + 1e-6).all()
    cosine = (surface[:, :3] * normal).sum(axis=1) / size
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def beside_a_ball(x, surface):
    """(far, apart, turned, curved) of particles no deeper than a cell: their distance [cells] from
    the surface of the ball of RADIUS, how wrong the one they know is [cells], their normal
    [degrees], and its divergence, relative to 2 / r."""
    r = np.linalg.norm(x - MIDDLE, axis=1)
    outer = r > RADIUS - DX
    x, r, surface = x[outer], r[outer], surface[outer]
    bend = surface[:, [4, 7, 9]].sum(axis=1)
    apart = surface[:, 3] - (r - RADIUS)
    turned = angles(surface, (x - MIDDLE) / r[:, None])
    return (r - RADIUS) / DX, apart / DX, turned, bend * r / 2


def test_of_a_sphere(tmp_path):
    x, surface = surfaces(tmp_path, body(SPHERE, 0.12))
    far, apart, turned, curved = beside_a_ball(x, surface)
    assert len(far) > 1000 and far.min() < -0.9
    assert np.abs(apart).max() < 1e-6
    assert turned.max() < 0.25  # differences over a cell
    assert curved == pytest.approx(1.0, abs=0.01)
    # where it is as round as that its normal is half sure: the two curvatures of 1 / r
    r = np.linalg.norm(x - MIDDLE, axis=1)
    outer = r > RADIUS - 0.5 * DX
    sure = 1.0 / (1.0 + (CURVATURE_WEIGHT * DX**2 * 2 / r[outer] ** 2) ** 4)
    # xy, xz and yz count once
    assert (np.linalg.norm(surface[outer, :3], axis=1) >= sure - 1e-3).all()
    assert np.linalg.norm(surface[outer, :3], axis=1).max() < 0.9
    assert surface[:, 3].min() >= -MAX_DEPTH_CELLS * DX * (1 + 1e-6)


def test_the_gradient_of_a_spheres_normal(tmp_path):
    """(1 - n n) / r, all nine."""
    x, surface = surfaces(tmp_path, body(SPHERE, 0.12))
    away = x - MIDDLE
    r = np.linalg.norm(away, axis=1)[:, None]
    outer = r[:, 0] > RADIUS - DX
    n = (away / r)[outer]
    exact = (np.eye(3) - n[:, :, None] * n[:, None, :]) / r[outer][:, :, None]
    found = surface[outer][:, CURVATURE_TO_FULL].reshape(-1, 3, 3)
    assert np.abs(found - exact).max() * DX < 0.01
    assert np.abs(exact[:, 0, 1]).max() * DX > 0.1


def test_of_a_box(tmp_path):
    x, surface = surfaces(tmp_path, body(BOX, 0.14))
    q = np.abs(x - MIDDLE) - HALF
    assert np.abs(surface[:, 3] - np.maximum(q.max(axis=1), -MAX_DEPTH_CELLS * DX)).max() < 1e-7
    face = q.argmax(axis=1)
    every = np.arange(len(x))
    normal = np.zeros_like(x)
    normal[every, face] = np.sign((x - MIDDLE)[every, face])
    one, two = np.sort(q, axis=1)[:, :0:-1].T
    # those that see no other face half a cell around: sure, exact, and flat
    flat = (one - two > 1.01 * DX) & (one > -DX)
    assert flat.sum() > 500
    assert np.abs(surface[flat, :3] - normal[flat]).max() < 1e-6
    assert np.abs(surface[flat, 4:]).max() * DX < 1e-6
    # at edges, whose normal turns by half a right angle within a particle, hardly sure
    edge = (one - two < 0.1 * DX) & (one > -0.3 * DX)
    assert edge.sum() > 50
    assert np.linalg.norm(surface[edge, :3], axis=1).max() < 0.25
    assert np.abs(surface[:, 4:]).max() * DX == pytest.approx(MAX_NORMAL_TURN_PER_CELL)


def of_a_made_ball(folder, source, share):
    """(apart within half a cell and whole [cells], turned [degrees]) beside a ball of a file; told
    with the turn of that share of the particles."""
    x, surface = surfaces(folder, body(f"{source}\nwidth = 0.16", 0.12))
    far, apart, turned, curved = beside_a_ball(x, surface)
    outermost = far > -0.5
    assert outermost.sum() > 1000
    print(
        f"within half a cell: {apart[outermost].min():.3f} to {apart[outermost].max():.3f} cells,"
        f" {np.quantile(turned, share):.1f} degrees, curvature {curved.mean():.2f}"
    )
    assert 0.7 < curved.mean() < 1.1
    return np.abs(apart[outermost]), np.abs(apart), turned


def test_of_a_mesh(tmp_path):
    """By voxels half a cell wide: good to .15 cell and 10 degrees at the surface."""
    found = ball(1.0, (0, 0, 0), 64)
    meshio.write_points_cells(tmp_path / "ball.obj", found.points, [("triangle", found.triangles)])
    outermost, apart, turned = of_a_made_ball(tmp_path, 'mesh = "ball.obj"', 1.0)
    assert outermost.max() < 0.15 and apart.max() < 0.25
    assert turned.max() < 10


def test_of_a_capture(tmp_path):
    """Gaussians on a sphere: its voxels are those that they touch or enclose."""
    cloud = egg()
    cloud = replace(
        cloud, x=(cloud.x - (7, 8, 9)) / (1.2, 1.0, 1.5), scale=0.8 * cloud.scale
    )  # fmt: skip
    ply.write(tmp_path / "ball.ply", cloud)
    outermost, _, turned = of_a_made_ball(tmp_path, 'gaussians = "ball.ply"', 0.99)
    assert outermost.max() < 0.25 and outermost.mean() < 0.15
    assert np.quantile(turned, 0.99) < 20 and turned.mean() < 6


@pytest.mark.parametrize("kind, stands", [("slip", True), ("stick", True), ("separate", False)])
def test_on_the_floor(tmp_path, kind, stands):
    """What stands on a mirroring floor goes on behind it: only its sides and its top are surfaces.
    A floor that only pushes meets the underside."""
    boundary = f'boundary = {{ default = "slip", bottom = "{kind}" }}'
    x, surface = surfaces(tmp_path, body(BOX, 0.0, boundary))
    q = np.abs(x[:, :2] - MIDDLE[:2]) - HALF[:2]
    low = (x[:, 2] < DX) & (q.max(axis=1) < -1.5 * DX)
    assert low.sum() > 50
    if not stands:
        assert np.abs(surface[low, :3] - [0, 0, -1]).max() < 1e-6
        assert surface[low, 3] == pytest.approx(-x[low, 2], abs=1e-7)
        return
    low = x[:, 2] < DX  # of all columns, corners too
    at_side = low & (q.max(axis=1) > -DX) & (np.abs(q[:, 0] - q[:, 1]) > 1.1 * DX)
    normal = np.zeros((len(x), 3))
    along = q.argmax(axis=1)
    normal[np.arange(len(x)), along] = np.sign((x - MIDDLE)[np.arange(len(x)), along])
    assert at_side.sum() > 50
    assert np.abs(surface[at_side, :3] - normal[at_side]).max() < 1e-3
    assert surface[at_side, 3] == pytest.approx(q[at_side].max(axis=1), abs=1e-3 * DX)
    assert np.abs(surface[low, 2]).max() < 0.05, "nobody looks down"
    assert (surface[low, 3] <= q[low].max(axis=1) + 0.1 * DX).all(), "nobody is near the floor"


def test_above_the_floor(tmp_path):
    """Half a cell above a slip floor a body has an underside."""
    x, surface = surfaces(tmp_path, body(BOX, 0.01))
    low = (x[:, 2] < 0.01 + DX) & ((np.abs(x[:, :2] - MIDDLE[:2]) - HALF[:2]).max(1) < -1.5 * DX)
    assert low.sum() > 50
    assert np.abs(surface[low, :3] - [0, 0, -1]).max() < 1e-6


def planned(folder, text):
    """(plan, what build_scene made) of a scene's text."""
    loaded = scene(folder, text)
    made = build_scene(loaded)
    return plan_for(loaded, known_of(loaded, made)), made


THIN = {
    "sheet of 1 cell": (0.16, 0.16, 0.02), "of 1.5": (0.16, 0.16, 0.03),
    "rod of 1 cell": (0.02, 0.16, 0.02), "of 1.5 ": (0.03, 0.16, 0.03),
}  # fmt: skip
THICK = {
    "sheet of 2": (0.16, 0.16, 0.04), "rod of 2": (0.04, 0.16, 0.04), "cube of 2": (0.04,) * 3,
    "cube of 4": (0.08,) * 3,
}  # fmt: skip


@pytest.mark.parametrize("size", [*THIN.values(), *THICK.values()], ids=[*THIN, *THICK])
def test_a_sheet_has_none(tmp_path, size):
    """The two sides of a sheet of one cell cancel at the nodes; contact finds it by particles.
    Edges, however many there are, are not thin."""
    known, low = size in THICK.values(), [-v / 2 for v in size]
    sheet = f"shape = {{ box = [{low}, {[-v for v in low]}] }}"
    ball = f'[[object]]\nname = "ball"\nmaterial = "clay"\n{SPHERE}\nposition = [0.2, 0.2, 0.2]\n'
    plan, made = planned(tmp_path, body(sheet, 0.14, name="sheet") + ball)
    told = {thing["name"]: thing for thing in made.objects}
    assert told["sheet"]["surface"] == known and told["ball"]["surface"]
    assert {phase.name: phase.surface for phase in plan.phases} == {"sheet": known, "ball": True}
    first, count = told["sheet"]["first_row"], told["sheet"]["row_count"]
    assert made.surface0[first : first + count].any() == known
    for group in plan.groups:
        assert ("surface" in group.channels) == plan.phases[group.phase].surface


FREE = ROOM + (
    f'[[object]]\nname = "body"\nmaterial = "clay"\n{SPHERE}\nposition = [0.2, 0.2, 0.12]\n'
)
POOL = """
[material.water]
kind = "fluid"
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.4, 0.4, 0.06]] }
"""
ROOMS = {
    "alone, walls that slip": (FREE, False),
    "alone, a wall that pushes": (
        FREE.replace("cell = 0.02", 'cell = 0.02\nboundary = { east = "separate" }'), True,
    ),
    "with a collider": (FREE + POST, True),
    "with scenery to look at": (FREE + POST.replace("collider = true\n", ""), False),
    "with a fluid": (FREE + POOL, True),
}  # fmt: skip


@pytest.mark.parametrize("text, asked", ROOMS.values(), ids=ROOMS)
def test_only_where_it_is_asked_for(tmp_path, text, asked):
    """What touches nothing has no channel, no dataset and no layer for it."""
    loaded = scene(tmp_path, text)
    known = prepare(loaded, SerialCommunicator(), tmp_path)
    plan = plan_for(loaded, known)
    write_initial_particles(loaded, known, SerialCommunicator(), tmp_path)
    rows = read_gaussians(tmp_path / file_layout.GAUSSIANS).surface0
    assert (rows is not None) == asked
    solid = next(group for group in plan.groups if group.material == "clay")
    assert ("surface" in solid.channels) == solid.surface == asked
    others = [group for group in plan.groups if group is not solid]
    assert not any("surface" in group.channels for group in others)
    if asked:
        of = np.array([thing["name"] == "body" for thing in known.objects])
        told = read_gaussians(tmp_path / file_layout.GAUSSIANS).object
        assert rows[of[told]].any(axis=1).all() and not rows[~of[told]].any()
    else:
        assert plan.planes == ()


def test_particles_carry_what_is_known(tmp_path):
    """Rows of surface0 become the channel of the particle they belong to; without them it is an
    error."""
    simulation, made = begin(tmp_path, body(SPHERE, 0.12))
    (group,) = simulation.groups
    at = group.index()
    assert np.array_equal(group.get("surface", at), made.surface0[group.ids[at]].astype("f8"))
    again = Simulation(simulation.plan, SerialCommunicator(), made.colliders)
    with pytest.raises(ValueError, match="surfaces are asked for"):
        again.put(made.x, made.v0, made.vol0, np.arange(len(made.x)), made.object)
