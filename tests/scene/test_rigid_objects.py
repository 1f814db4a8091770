"""Free rigid bodies in scenes: what is refused, with its line, and what --plan says."""

import subprocess
import sys

import pytest

import vgmpi
from vgmpi.planning.cost.plan_report import format_plan
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
    ('material = "water"', 'material = "oak"\nrigid = true', "no object has particles"),
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
        '[[probe]]\nname = "p"\nsampling_rate = 10\nobject = "log"\n[[object]]\n' + LOG,
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


@pytest.mark.parametrize("engine", ["numpy"])
def test_an_engine_without_free_bodies_says_so(tmp_path, engine):
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE)
    job = subprocess.run(
        [sys.executable, "-m", "vgmpi", scene, "-o", tmp_path / "out", "--engine", engine],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert job.returncode == 2
    assert "engine numpy has no free rigid bodies (object.rigid)" in job.stderr
    assert "Traceback" not in job.stderr


def test_a_body_outside_the_domain(tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE.replace("center = [0.2, 0.1, 0.15]", "center = [0.2, 0.1, 0.25]"))
    job = subprocess.run(
        [sys.executable, "-m", "vgmpi", scene, "-o", tmp_path / "out"],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert job.returncode == 2
    assert "the center of mass is outside the domain" in job.stderr


def test_the_plan_names_them(tmp_path):
    scene = vgmpi.load(tmp_path / "scene.toml", text=SCENE)
    report = format_plan(scene, vgmpi.plan(scene), ranks=1)
    assert "rigid       log: free bodies without particles" in report
