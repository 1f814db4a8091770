"""What is too large is told in one line before it is made, and estimates are bounds from below."""

import json
import sys
import tracemalloc

import numpy as np
import pytest

from tests.preprocess.test_shape_sdf import SHAPES
from tests.support.launch import ROOT, on_ranks, run
from tests.support.small_scenes import ROOM, scene, write
from vgmpi.gaussians import shape_distance
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.formats import ply
from vgmpi.preprocess import memory_estimate, shape_sdf
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.runtime import process_limits
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.shapes import Shape

MOST = 1000  # MB that may be in use at any time
BODY = (
    '[[object]]\nname = "lump"\nmaterial = "clay"\nshape = { box = [[0, 0, 0], [0.1, 0.1, 0.1]] }'
)


def rock(keys, source="mesh"):
    """The body, and scenery of a file."""
    scenery = '\n[[object]]\nname = "rock"\nrole = "scenery"\nposition = [0, 0, 0]\n'
    return f"{BODY}{scenery}{source} = {keys}"


CUBE = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)) + (
    "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
)
GRID = "# vtk DataFile Version 3.0\na\nASCII\nDATASET STRUCTURED_POINTS\nORIGIN 0 0 0\n"


def cloud(folder, *scales):
    n = len(scales)
    x, quat = np.arange(3.0 * n).reshape(n, 3), np.tile([1.0, 0, 0, 0], (n, 1))
    size = np.outer(scales, [1.0, 1.0, 1.0])
    ply.write(folder / "a.ply", GaussianCloud(x, quat, size, np.full(n, 0.9), np.zeros((n, 1, 3))))


def triangles(folder, count):
    """As many triangles, each over all others."""
    flat = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
    (folder / "a.obj").write_text(flat + "f 1 2 3\nf 1 2 4\n" * (count // 2))


def sparse(path, size):
    with open(path, "wb") as file:
        file.truncate(size)


# objects, what makes their files, key=value, line and key as told (None: nothing is wrong), words
CASES = {
    "cells of 20 um": (BODY, None, "domain.cell=20 um", "domain.cell", "makes at least 9.8"),
    "64 per cell": (
        BODY + "\nparticles_per_cell = 64",
        None,
        "domain.cell=40 um",
        "domain.cell",
        "particles of 'lump', 1e-05 m apart",
    ),
    "a hall of scenery": (
        BODY + '\n[[object]]\nname = "hall"\nrole = "scenery"\nshape = { sphere = { center ='
        " [0, 0, 0], radius = 1000 } }",
        None,
        "",
        "object.hall.shape",
        "Gaussians of 'hall', 0.01 m apart",
    ),
    "a needle": (
        BODY + '\n[[object]]\nname = "needle"\nrole = "scenery"\nshape = { box = [[0, 0, 0],'
        " [1e12, 0.1, 0.1]] }",
        None,
        "",
        "object.needle.shape",
        "Gaussians of 'needle'",
    ),
    "far away": (
        BODY + '\n[[object]]\nname = "far"\nrole = "scenery"\nshape = { box = [[0, 0, 0],'
        " [1, 1, 1]] }\norigin = [1e80, 0, 0]",
        None,
        "",
        "object.far.origin",
        "reaches 1e+80 m from the origin; at most 4.5e+13 m",
    ),
    "many small ones": (
        BODY
        + "".join(
            f'\n[[object]]\nname = "b{k}"\nmaterial = "clay"\nshape = {{ box = [[0, 0, 0],'
            f" [0.4, 0.4, 0.01]] }}\norigin = [0, 0, {0.02 + 0.01 * k}]"
            for k in range(30)
        ),
        None,
        "domain.cell=100 um",
        "domain.cell",
        ", with all others ",
    ),
    "a mesh of 100 km": (
        rock('"a.obj"\nheight = "100 km"'),
        lambda folder: (folder / "a.obj").write_text(CUBE),
        "",
        "object.rock.height",
        "Gaussians, 0.005 m apart on a surface of 6e+10 m2, take at least",
    ),
    "a mesh that is filled": (
        rock('"a.obj"\nheight = "9 m"\ncollider = true'),
        lambda folder: (folder / "a.obj").write_text(CUBE),
        "",
        "object.rock.height",
        "Gaussians of 'rock', 0.01 m apart",
    ),
    "triangles over each other": (
        rock('"a.obj"\nheight = "1 mm"'),
        lambda folder: triangles(folder, 60_000),
        "",
        None,
        "",
    ),
    "a grid of points": (
        rock('"a.vtk"'),
        lambda folder: (folder / "a.vtk").write_text(
            GRID + "SPACING 1 1 1\nDIMENSIONS 250 250\t250\n"
        ),
        "",
        "object.rock.mesh",
        "holds StructuredPoints: allowed are PolyData and UnstructuredGrid",
    ),
    "a mesh of a terabyte": (
        rock('"a.stl"'),
        lambda folder: sparse(folder / "a.stl", 1 << 40),
        "",
        "object.rock.mesh",
        "its 1,099,511,627,776 bytes take at least 1.5 TiB",
    ),
    "a mesh of 1e-310": (
        rock('"a.obj"\nheight = 1'),
        lambda folder: (folder / "a.obj").write_text(
            "v 0 0 0\nv 1e-310 0 0\nv 0 1e-310 1e-310\nf 1 2 3\n"
        ),
        "",
        "object.rock.mesh",
        "is 1e-310 large; allowed are 1e-100 to 1e+100",
    ),
    "a flat mesh": (
        rock('"a.obj"\nheight = 1'),
        lambda folder: (folder / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 1e-310\nf 1 2 3\n"),
        "",
        "object.rock.height",
        "the object is flat in this direction",
    ),
    "a line": (
        rock('"a.obj"'),
        lambda folder: (folder / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"),
        "",
        "object.rock.mesh",
        "its triangles have an area of 0 m2",
    ),
    "Gaussians of e^69": (
        rock('"a.ply"', "gaussians"),
        lambda folder: cloud(folder, 1.0, np.exp(69.0)),
        "",
        "object.rock.gaussians",
        "1 of 2 Gaussians are not finite (or above 1e18), have no size or no rotation",
    ),
    "Gaussians scaled": (
        rock('"a.ply"\nscale = 1e13', "gaussians"),
        lambda folder: cloud(folder, 1.0, 1e6),
        "domain.cell=0.02",
        "object.rock.scale",
        "makes a Gaussian 1e+19 m large; at most 1e+18 m",
    ),
    "Gaussians far apart": (
        rock('"a.ply"\nscale = 20\ncollider = true\nfill = false', "gaussians"),
        lambda folder: cloud(folder, *[1.0] * 20),
        "",
        "object.rock.scale",
        "voxels of 0.01 m takes at least",
    ),
}

# the commands of a list, one after the other; the peak memory is the kernel's, set back before each
CHECK = """
import contextlib, io, json, sys
from tests.support import peak_memory
from vgmpi.commands import cli
from vgmpi.runtime import process_limits
process_limits.available_memory = lambda swap=False: 8 << 30  # on any machine
for command in json.loads(sys.argv[1]):
    peak_memory.forget()
    with contextlib.redirect_stderr(io.StringIO()) as said:
        code = cli.main(command)
    print(json.dumps([code, peak_memory.megabytes(), said.getvalue()]))
"""


@pytest.fixture(scope="module")
def checked(tmp_path_factory):
    """(exit code, peak memory of the process [MB], what is said) of --check of every case."""
    commands = []
    for k, (objects, files, change, *_) in enumerate(CASES.values()):
        folder = tmp_path_factory.mktemp(f"case{k}")
        if files is not None:
            files(folder)
        path = write(folder, ROOM + objects + "\n")
        commands.append([str(path), "--check", *(["--set", change] if change else [])])
    done = run([sys.executable, "-c", CHECK, json.dumps(commands)])
    assert done.returncode == 0, done.stderr[-2000:]
    lines = [json.loads(x) for x in done.stdout.splitlines() if x.startswith("[")]
    return dict(zip(CASES, lines, strict=True))


@pytest.mark.parametrize("name", CASES)
def test_one_line_before_anything_large_is_made(checked, name):
    code, peak, said = checked[name]
    *_, key, words = CASES[name]
    assert peak < MOST
    if key is None:
        assert code == 0, said
        return
    (line,) = said.splitlines()
    assert code == 2 and f" {key}: " in line and words in line, line


@pytest.mark.mpi
def test_all_ranks_end_with_one_line(tmp_path):
    path = write(tmp_path, ROOM + BODY + "\n")
    command = on_ranks(2, "-m", "vgmpi", path, "--set", "domain.cell=20 um")
    for flags in (["--plan"], ["-q"]):
        done = run([*command, *flags], cwd=ROOT)
        lines = [line for line in done.stderr.splitlines() if "domain.cell" in line]
        assert done.returncode == 2 and len(lines) == 1, done.stderr
        assert "makes at least 9.8" in lines[0]
    assert [p.name for p in tmp_path.iterdir() if p.suffix != ".toml"] == []


def made_of(shape, role):
    kind = 'material = "clay"' if role == "body" else 'role = "scenery"'
    text = json.dumps(shape).replace('": ', " = ").replace('"', "")
    return (
        ROOM.replace("[0.4, 0.4, 0.4]", "[2, 2, 2]")
        + f'[[object]]\nname = "a"\n{kind}\nshape = {text}\n'
        + "origin = [1, 1, 1]\nparticles_per_cell = 27\n"
        + ("" if role == "body" else BODY + "\n")
    )


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("role", ["body", "scenery"])
def test_shapes_are_counted_from_below(tmp_path, name, role):
    made = scene(tmp_path, made_of(SHAPES[name][0], role))
    found = memory_estimate.min_particle_count(made, made.object[0])
    real = build_scene(made)
    count = len(real.x) if role == "body" else len(real.scenery.x)
    assert 0.7 * count < found <= 1.02 * count  # of a skin of few layers the last one is a part


@pytest.mark.parametrize("role", ["body", "scenery"])
def test_memory_is_counted_from_below(tmp_path, role):
    made = scene(tmp_path, made_of({"box": [[0, 0, 0], [0.5, 0.5, 0.5]]}, role))
    tracemalloc.start()
    try:
        real = build_scene(made)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    count = len(real.x) if role == "body" else len(real.scenery.x)
    assert peak > count * (
        memory_estimate.BYTES_PER_PARTICLE[role] + memory_estimate.BYTES_PER_PARTICLE_MERGED[role]
    )


def test_what_fits_is_not_looked_at_twice(tmp_path, monkeypatch):
    """Boxes are enough where they fit; where they do not, what is in them is what counts."""
    ball = {"difference": [SHAPES["box"][0], {"box": [[-0.19, 0.11, 0.01], [0.3, 0.3, 0.25]]}]}
    made = scene(tmp_path, made_of(ball, "body"))
    count = len(build_scene(made).x)
    bytes_of = (
        memory_estimate.BYTES_PER_PARTICLE["body"]
        + memory_estimate.BYTES_PER_PARTICLE_MERGED["body"]
    )
    monkeypatch.setattr(
        process_limits, "available_memory", lambda swap=False: int(1.5 * count * bytes_of)
    )
    memory_estimate.require_memory_for_shapes(made)  # its box has six times as many places
    monkeypatch.setattr(
        process_limits, "available_memory", lambda swap=False: int(0.5 * count * bytes_of)
    )
    with pytest.raises(SceneError, match="domain.cell: 0.02 m makes at least .* GiB are free"):
        memory_estimate.require_memory_for_shapes(made)


@pytest.mark.parametrize("name", SHAPES)
def test_cubes_leave_out_nothing(name):
    shape = Shape.model_validate(SHAPES[name][0])
    if not shape_sdf.is_lipschitz(shape):
        pytest.skip("near an ellipsoid distances are no bounds")
    low = np.array([-shape_sdf.support(shape, -e) for e in np.eye(3)])
    high = np.array([shape_sdf.support(shape, e) for e in np.eye(3)])
    spacing, skin, asked = 0.004, 0.0041, []
    half = np.sqrt(3.0) / 2 * shape_sdf.BLOCK * spacing

    def wanted(points):
        asked.append(len(points))
        d = shape_distance.distance(shape, points)
        return (d < 0) & (d > -skin)

    def none(middles):
        d = shape_distance.distance(shape, middles)
        return (d > half) | (d < -skin - half)

    every = shape_sdf.lattice(wanted, low, high, spacing)
    places = sum(asked)
    asked.clear()
    assert np.array_equal(shape_sdf.lattice(wanted, low, high, spacing, none), every)
    assert len(every) and sum(asked) < 1.6 * places  # cubes stick out of small boxes


def test_few_points_are_looked_at_together(monkeypatch):
    """Also where a sheet, or a line, of a lattice has more."""
    for most in (1, 7, 60, 500, 10**6):
        monkeypatch.setattr(shape_sdf, "_POINTS_PER_BATCH", most)
        sizes = []

        def seen(points, sizes=sizes):
            sizes.append(len(points))
            return np.ones(len(points), dtype=bool)

        found = shape_sdf.lattice(seen, np.zeros(3), np.array([0.3, 0.4, 0.5]), 0.1)
        index = np.rint(found / 0.1 - 0.5).astype(int)
        assert np.array_equal(index, np.argwhere(np.ones((5, 6, 7))) - 1)
        assert max(sizes) <= most


def test_free_memory_is_a_number_of_bytes():
    free, with_swap = (process_limits.available_memory(swap=swap) for swap in (False, True))
    meanwhile = 1 << 30  # [bytes] that others may take between the two readings
    assert 1 << 20 < free <= with_swap + meanwhile < 1 << 50


def test_a_control_group_leaves_what_it_does_not_use(tmp_path, monkeypatch):
    """Files in memory are free; groups around it count as well."""
    group = tmp_path / "job" / "step"
    group.mkdir(parents=True)
    for at, most in ((group, "max"), (group.parent, str(3000 << 20))):
        (at / "memory.max").write_text(most + "\n")
        (at / "memory.current").write_text(f"{2000 << 20}\n")
        (at / "memory.stat").write_text(f"anon 5\nactive_file {700 << 20}\ninactive_file 0\n")
    own = tmp_path / "cgroup"
    own.write_text("1:cpu:/elsewhere\n0::/job/step\n")
    monkeypatch.setattr(process_limits, "_OWN", own)
    monkeypatch.setattr(process_limits, "_CGROUPS", tmp_path)
    assert process_limits._cgroup_headroom() == [1700 << 20]
