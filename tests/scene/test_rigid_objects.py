"""Free rigid bodies in scenes: what is refused, with its line, and what --plan says."""

import logging
import subprocess
import sys

import pytest

import vgmpi
from tests.support.simulate import begin
from vgmpi.features.rigid_bodies.plan import RigidBodiesPlan
from vgmpi.planning.cost.plan_report import format_plan
from vgmpi.planning.plan import time_step_bounds
from vgmpi.runtime.config.schema import SceneError

SCENE = """
[domain]
size = [0.4, 0.2, 0.2]
cell = 0.01
[time]
end = 0.1
[accuracy]
transfer = "apic-corrected"
[material.water]
kind = "fluid"
[material.oak]
kind = "elastic"
density = 700
youngs_modulus = 1e6
[material.grains]
kind = "sand"
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.4, 0.2, 0.1]] }
[[object]]
name = "log"
material = "oak"
rigid = true
shape = { sphere = { center = [0.2, 0.1, 0.15], radius = 0.04 } }
"""
LOG = 'name = "log"\n'
RIGID = "object.log.rigid"
WRONG = [
    ('material = "oak"', 'material = "grains"', f"{RIGID}: is only for solids"),
    ('material = "oak"', 'material = "water"', f"{RIGID}: is only for solids"),
    (LOG, LOG + "release_time = 0.1\n", "object.log.release_time: is not for rigid bodies"),
    (LOG, LOG + 'phase = "x"\n', "object.log.phase: is not for rigid bodies"),
    (LOG, LOG + "motion = { velocity = [1, 0, 0] }\n", "object.log.motion: is not for rigid"),
    (LOG, LOG + "volume_fraction = 0.5\n", "object.log.volume_fraction: is not for rigid bodies"),
    (LOG, LOG + "track_deformation = true\n", "object.log.track_deformation: is not for rigid"),
    (LOG, LOG + "restitution = 1.5\n", "object.log.restitution: must be"),
    (LOG, LOG + "restitution = -1\n", "object.log.restitution: must be"),
    ("rigid = true", 'rigid = "yes please"', f"{RIGID}: must be"),
    ("rigid = true", "restitution = 0.5", "object.log.restitution: is only for bodies with rigid"),
    ("apic-corrected", "aflip", f'{RIGID}: is not for accuracy.transfer = "aflip"'),
    ("apic-corrected", "flip", f'{RIGID}: is not for accuracy.transfer = "flip"'),
    (
        '[[object]]\nname = "pool"\nmaterial = "water"',
        '[[probe]]\nname = "p"\nsampling_rate = 10\nwall = "all"\n'
        '[[object]]\nname = "pool"\nmaterial = "oak"\nrigid = true',
        "probe.p.wall: measures particles, and all bodies are rigid",
    ),
    (
        '"water"\nshape',
        '"water"\nrole = "scenery"\nrigid = true\nshape',
        "object.pool.rigid: is not for scenery",
    ),
    (
        LOG,
        LOG.replace("log", "other") + 'material = "grains"\n'
        "shape = { box = [[0, 0, 0.1], [0.1, 0.1, 0.15]] }\n"
        '[[coupling]]\nkind = "drag"\nbetween = ["water", "grains"]\nhydraulic_conductivity = 0.1\n'
        "[[object]]\n" + LOG,
        f"{RIGID}: is not for scenes in which materials mix",
    ),
    (
        "[[object]]\n" + LOG,
        '[[load]]\nobject = "log"\nforce = [1, 0, 0]\n[[object]]\n' + LOG,
        "'log' is rigid: it has no particles",
    ),
    (
        "[[object]]\n" + LOG,
        '[[probe]]\nname = "p"\nsampling_rate = 10\ncollider = "log"\n[[object]]\n' + LOG,
        "no collider",
    ),
]


@pytest.mark.parametrize(("old", "new", "message"), WRONG)
def test_what_is_refused(tmp_path, old, new, message):
    assert SCENE.count(old) >= 1
    with pytest.raises(SceneError) as error:
        vgmpi.load(tmp_path / "scene.toml", text=SCENE.replace(old, new, 1))
    assert message in str(error.value)
    assert "scene.toml:" in str(error.value)


@pytest.mark.parametrize(("radius", "length"), [("0.9", "1.8"), ("4", "8")])
def test_a_body_much_larger_than_the_domain(tmp_path, radius, length):
    """To search it would take minutes."""
    text = SCENE.replace("radius = 0.04", f"radius = {radius}")
    scene = vgmpi.load(tmp_path / "scene.toml", text=text)
    with pytest.raises(SceneError) as error:
        vgmpi.plan(scene)
    (line,) = str(error.value).splitlines()
    assert "scene.toml:24: object.log.rigid: is " in line
    assert f"is {length} m long; at most 1.6 m are possible in this domain" in line


def test_a_body_outside_the_domain(tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE.replace("center = [0.2, 0.1, 0.15]", "center = [0.2, 0.1, 0.25]"))
    job = subprocess.run(
        [sys.executable, "-m", "vgmpi", scene, "-o", tmp_path / "out"],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert job.returncode == 2
    assert "the center of mass is outside the domain" in job.stderr


MORE = """
[[object]]
name = "{name}"
material = "{material}"
rigid = true
shape = {{ {shape} }}
"""
EGG = "ellipsoid = { center = [0.1, 0.08, 0.15], radii = [0.05, 0.037, 0.03] }"
FOAM = '[material.foam]\nkind = "elastic"\ndensity = 5\nyoungs_modulus = 1e6\n'


def report_of(folder, text):
    """The text of --plan."""
    scene = vgmpi.load(folder / "scene.toml", text=text)
    return format_plan(scene, vgmpi.plan(scene), ranks=1)


def test_the_plan_tells_of_them(tmp_path):
    report = report_of(tmp_path, SCENE)
    (line,) = (line for line in report.splitlines() if line.startswith("  rigid"))
    assert "log: 0.187" in line  # 4 / 3 pi r^3 times 700 kg/m3 = 0.1877 kg
    assert ", 0.7 times the density of water, 8.0 cells thick, " in line
    assert "MiB of distances per rank" in line
    assert "warning" not in report
    assert "water: free rigid bodies" in report


def test_the_plan_sums_up_many(tmp_path):
    text = SCENE
    for k in range(9):
        shape = f"sphere = {{ center = [{0.02 + 0.04 * k}, 0.03, 0.15], radius = 0.015 }}"
        text += MORE.format(name=f"bead {k}", material="oak", shape=shape)
    (line,) = (line for line in report_of(tmp_path, text).splitlines() if "  rigid  " in line)
    assert "10 bodies of 0.009" in line
    assert " to 0.187" in line
    assert "3.0 to 8.0 cells thick" in line


@pytest.mark.parametrize(
    ("material", "shape", "message"),
    [
        ("oak", "box = [[0, 0, 0.18], [0.1, 0.1, 0.19]]",
         "other: rigid and thinner than 2 cells: what flows may pass through"),
        ("foam", "box = [[0, 0, 0.12], [0.1, 0.1, 0.2]]",
         "other: rigid and lighter than 0.01 of the heaviest that it may meet, 1000 kg/m3"),
        ("oak", "sphere = { center = [0.265, 0.1, 0.15], radius = 0.03 }",
         "log and other overlap at the start by 0.5 cells (0.005 m)"),
    ],
)  # fmt: skip
def test_the_plan_warns(tmp_path, material, shape, message):
    text = SCENE + FOAM + MORE.format(name="other", material=material, shape=shape)
    warnings = [line for line in report_of(tmp_path, text).splitlines() if "  warning  " in line]
    assert len(warnings) == 1
    assert message in warnings[0]


def test_the_plan_warns_of_an_overlap_with_a_collider(tmp_path):
    text = SCENE + '[[object]]\nname = "post"\nrole = "scenery"\ncollider = true\n'
    text += "shape = { box = [[0.235, 0.05, 0.1], [0.3, 0.15, 0.2]] }\n"
    assert "log and post overlap at the start by 0.5 cells (0.005 m)" in report_of(tmp_path, text)


@pytest.mark.parametrize(("kind", "count"), [("fixed", 0), ("spring", 1)])
def test_the_plan_accepts_an_overlap_of_jointed_bodies(tmp_path, kind, count):
    """They do not collide, but for those at the ends of a spring."""
    shape = "sphere = { center = [0.265, 0.1, 0.15], radius = 0.03 }"
    text = SCENE + MORE.format(name="other", material="oak", shape=shape)
    more = "to = [0.26, 0.1, 0.15]\nstiffness = 10\n" if kind == "spring" else ""
    text += (
        f'[[joint]]\nkind = "{kind}"\nbetween = ["log", "other"]\nat = [0.24, 0.1, 0.15]\n{more}'
    )
    assert report_of(tmp_path, text).count("overlap at the start") == count


STEEL = '[material.steel]\nkind = "elastic"\ndensity = 7800\nyoungs_modulus = {modulus}\n'
ANVIL = """
[[object]]
name = "anvil"
material = "steel"
shape = { box = [[0, 0, 0.1], [0.06, 0.06, 0.16]] }
"""


def test_the_plan_advises_that_a_stiff_body_be_rigid(tmp_path):
    """A wave of steel takes sqrt(E / density) = 5e3 m/s and more; that of the water 1.5e2 or so."""
    text = SCENE + STEEL.format(modulus="2e11") + ANVIL
    (line,) = (
        line
        for line in report_of(tmp_path, text).splitlines()
        if line.startswith("  advice") and "rigid = true" in line
    )
    scene = vgmpi.load(tmp_path / "scene.toml", text=text)
    plan = vgmpi.plan(scene)
    dt, longer = time_step_bounds(scene, plan)[0][0], time_step_bounds(scene, plan)[1][0]
    assert "; anvil, " in line
    assert line.endswith("would deform by less than 0.1 %: rigid = true saves as much")
    assert f"steps would be {longer / dt:.1f} times as long" in line


@pytest.mark.parametrize(
    "text",
    [
        SCENE,
        SCENE + STEEL.format(modulus="2e6") + ANVIL,  # it bends
        SCENE + STEEL.format(modulus="2e11") + ANVIL.replace("shape", "rigid = true\nshape"),
        SCENE.replace("apic-corrected", "aflip").split("[[object]]\nname = \"log\"")[0]
        + STEEL.format(modulus="2e11") + ANVIL,  # no rigid bodies there
    ],
)  # fmt: skip
def test_the_plan_advises_no_other(tmp_path, text):
    assert "rigid = true saves" not in report_of(tmp_path, text)


def test_a_body_that_leaves_the_domain(tmp_path):
    scene = tmp_path / "scene.toml"
    walls = 'cell = 0.01\nboundary = { default = "slip", top = "open" }\n'
    scene.write_text(
        SCENE.replace("cell = 0.01\n", walls)
        .replace("center = [0.2, 0.1, 0.15]", "center = [0.2, 0.1, 0.18]")
        .replace('name = "log"', 'name = "log"\nvelocity = [0, 0, 4]')
    )
    job = subprocess.run(
        [sys.executable, "-m", "vgmpi", scene, "-o", tmp_path / "out"],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert job.returncode == 3
    assert "object log, step " in job.stderr
    assert ": it left the domain" in job.stderr
    assert "Traceback" not in job.stderr
    head = (tmp_path / "out" / "ledger.csv").read_text().split("\n")[0]
    assert "rigid_momentum_x" in head.split(",")


def test_a_thin_body_is_told_of_once(tmp_path, caplog):
    shape = "box = [[0, 0, 0.18], [0.1, 0.1, 0.19]]"
    text = SCENE + MORE.format(name="sheet", material="oak", shape=shape)
    with caplog.at_level(logging.WARNING, "vgmpi"):
        report = report_of(tmp_path, text)
    assert report.count("sheet: rigid and thinner than 2 cells") == 1
    assert "sheet" not in caplog.text


def test_the_plan_counts_the_surface_points_of_the_solver(tmp_path):
    text = SCENE + MORE.format(name="egg", material="oak", shape=EGG)
    simulation, _ = begin(tmp_path, text)
    first = simulation.features["rigid_bodies"].surface.first
    scene = vgmpi.load(tmp_path / "scene.toml", text=text)
    told = [body.points for body in vgmpi.plan(scene).feature(RigidBodiesPlan).at_start.bodies]
    assert told == (first[1:] - first[:-1]).tolist()
    assert min(told) > 300
